"""The documentation: `make docs` builds it, warnings are errors, and nothing is fetched, neither then nor by its reader."""

import importlib.metadata
import re
from pathlib import Path
from typing import Any

import numpy as np
from docutils.nodes import Element, Node, SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from numpy.typing import ArrayLike, NDArray
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import stringify_annotation

import prioritized_ik

#: Public names by stage, as the stub file of the package groups them.
STAGES = {
    title: re.findall(r" as (\w+)", block)
    for title, block in re.findall(
        r"^# (.+)\n((?:from .+\n)+)", Path(prioritized_ik.__file__).with_suffix(".pyi").read_text("utf-8"), re.MULTILINE
    )
}

project = "prioritized_ik"
version = release = importlib.metadata.version("prioritized-ik")
copyright = "the authors of prioritized_ik; Apache-2.0"

#: How the types of arrays would be written, and what they are called.
WRITTEN_OUT = {stringify_annotation(ArrayLike, "smart"): "ArrayLike"} | {
    stringify_annotation(NDArray[kind], "smart"): "ndarray" for kind in (np.float64, np.bool_, np.int_, np.uint8, Any)
}

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_block"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "measured.md"]  # which a page includes

default_role = "literal"  # docstrings write code in single backticks
napoleon_numpy_docstring = False
napoleon_attr_annotations = False
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = "prioritized_ik"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_search_summary = False  # it is fetched page by page, which browsers refuse of files
html_copy_source = False
html_math_renderer = "mathml"
copybutton_exclude = ".linenos, .gp, .go"


def _inline(writer: Any, node: Element) -> None:
    writer.body.append(tex2mathml(node.astext()))
    raise SkipNode


def _display(writer: Any, node: Element) -> None:
    writer.body.append(f'<div class="equation">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise SkipNode


class PublicNames(SphinxDirective):
    """`.. public-names:: STAGE`: the documentation of all that a stage of the package's stub file exports."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[Node]:
        """Return it, every name by its autodoc directive."""
        names = STAGES[self.arguments[0]]
        return self.parse_text_to_nodes("\n\n".join(f".. auto{_kind(name)}:: prioritized_ik.{name}" for name in names))


def _kind(name: str) -> str:
    found = getattr(prioritized_ik, name)
    if not isinstance(found, type):
        return "function"
    return "exception" if issubclass(found, Exception) else "class"


def _named(app: Sphinx, what: str, name: str, found: object, options: object, said: str | None, returns: str | None) -> Any:
    """Return a signature with the types of arrays by their names; they would be written out in full."""
    for text, short in WRITTEN_OUT.items():
        said, returns = said and said.replace(text, short), returns and returns.replace(text, short)
    return said, returns


def setup(app: Sphinx) -> None:
    """Write equations as MathML, which browsers draw by themselves."""
    app.connect("autodoc-process-signature", _named)
    app.add_directive("public-names", PublicNames)
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
