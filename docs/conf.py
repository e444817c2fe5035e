"""The documentation: `make docs` builds it, warnings are errors, and nothing is fetched, neither then nor by its reader."""

import importlib.metadata
from typing import Any

from docutils.nodes import Element, SkipNode
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

project = "prioritized_ik"
version = release = importlib.metadata.version("prioritized-ik")
copyright = "the authors of prioritized_ik; Apache-2.0"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_block"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

default_role = "literal"  # docstrings write code in single backticks
napoleon_numpy_docstring = False
napoleon_attr_annotations = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = "prioritized_ik"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"
copybutton_exclude = ".linenos, .gp, .go"


def _inline(writer: Any, node: Element) -> None:
    writer.body.append(tex2mathml(node.astext()))
    raise SkipNode


def _display(writer: Any, node: Element) -> None:
    writer.body.append(f'<div class="equation">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise SkipNode


def setup(app: Sphinx) -> None:
    """Write equations as MathML, which browsers draw by themselves."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
