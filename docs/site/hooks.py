"""What `mkdocs` does besides: formulas become MathML, which browsers draw without a script, and tutorials run."""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))

import tutorials

INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)
WIDE = '<div style="overflow-x: auto">{}</div>'  # narrow screens scroll the formula, not the page


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the files of the site with those that running the tutorials gives."""
    docs = Path(config.docs_dir)
    for path, content in tutorials.pages(docs / "tutorials", docs.parent / "build" / "tutorials"):
        files.append(File.generated(config, f"tutorials/{path}", content=content))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """Return the page with its formulas drawn."""
    content = INLINE.sub(lambda found: convert(html.unescape(found[1]), display="inline"), content)
    return BLOCK.sub(lambda found: WIDE.format(convert(html.unescape(found[1]), display="block")), content)
