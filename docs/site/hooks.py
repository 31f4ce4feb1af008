"""What `mkdocs` does besides: formulas become MathML, which browsers draw without a script."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Return the page with its formulas drawn."""
    content = INLINE.sub(lambda found: convert(html.unescape(found[1]), display="inline"), content)
    return BLOCK.sub(lambda found: convert(html.unescape(found[1]), display="block"), content)
