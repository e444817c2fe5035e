r"""Text with the paper's symbols as LaTeX: `J_aᵀ` and `e^{i−1}` are indices, `hinge_order` is a name.

What comes out is ASCII and needs `\usepackage{textcomp,amssymb}`; one without LaTeX becomes a bold `?`.
"""

import re

from pylatexenc.latexencode import RULE_DICT, RULE_REGEX, UnicodeToLatexConversionRule, UnicodeToLatexEncoder

_SUPERSCRIPT = re.compile(r"\^(?:\{([^}]*)\}|\(([^)]*)\)|(\w))")
_SUBSCRIPT = re.compile(r"(?<=[^\W_])(?<![^\W_]{3})_([^\W_])(?![^\W_ᵀ])")  # of one letter, or dX; and one letter itself


def latex(text: str) -> str:
    """Return `text` as LaTeX."""
    return str(_ENCODER.unicode_to_latex(text.replace("`", "")))


def _raised(match: re.Match[str]) -> str:
    return rf"\ensuremath{{^{{{latex(next(part for part in match.groups() if part is not None))}}}}}"


def _lowered(match: re.Match[str]) -> str:
    return rf"\ensuremath{{_{{{latex(match[1])}}}}}"


_ENCODER = UnicodeToLatexEncoder(
    conversion_rules=[
        UnicodeToLatexConversionRule(RULE_REGEX, [(_SUPERSCRIPT, _raised), (_SUBSCRIPT, _lowered)]),
        UnicodeToLatexConversionRule(RULE_DICT, {ord("ᵀ"): r"\ensuremath{^{\mathsf{T}}}"}),
        "defaults",
    ],
    unknown_char_policy="replace",
)
