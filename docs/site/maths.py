"""Formulas as MathML, which browsers show without a script: no network at view time."""

from __future__ import annotations

import re

from latex2mathml.converter import convert

BLOCK = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"\$`([^`\n]+)`\$")


def with_mathml(text: str) -> str:
    """``text`` with its formulas (GitHub's fences and marks) as MathML."""
    text = BLOCK.sub(lambda m: f"\n{_mathml(m[1], 'block')}\n", text)
    return INLINE.sub(lambda m: _mathml(m[1], "inline"), text)


def _mathml(latex: str, display: str) -> str:
    return str(convert(" ".join(latex.split()), display=display))
