"""MkDocs hook: links from pages to files of the repository outside docs/, which MkDocs does not support.

A linked file outside docs/ is copied into the site, under files/. A link to a folder, or to a page that is not part of
the site, becomes plain text.
"""

from __future__ import annotations

import os.path
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

TOP = Path(__file__).parents[1]
LINK = re.compile(  # the text may be an image
    r"(?P<image>!?)\[(?P<text>(?:!\[[^\]]*\]\([^)]*\)|[^\]])*)\]\((?P<path>(?:\.\./)+[^)#\s]*)(?P<anchor>#[^)]*)?\)"
)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    here = Path(page.file.abs_src_path).parent

    def replace_link(found: re.Match[str]) -> str:
        target = (here / found["path"]).resolve()
        if target.is_relative_to(config.docs_dir):
            return found[0]
        if not target.is_relative_to(TOP) or not target.is_file() or target.suffix == ".md":
            return found["text"]
        name = f"files/{target.relative_to(TOP).as_posix()}"
        if files.get_file_from_path(name) is None:
            files.append(File.generated(config, name, abs_src_path=str(target)))
        path = os.path.relpath(name, Path(page.file.src_uri).parent).replace(os.sep, "/")
        return f"{found['image']}[{found['text']}]({path}{found['anchor'] or ''})"

    return LINK.sub(replace_link, markdown)
