"""Write the generated blocks of the documents: `python docs/generate.py`, which `make docs` runs first.

The function NAME of `verdict_blocks.py`, `error_blocks.py` or `program_blocks.py` returns the text between
`<!-- generated: NAME -->` and `<!-- end -->`. Its sources are the program, the fabric presets, and stored results
(`stored.py`). `tests/test_documents.py` checks that all blocks are up to date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # tests load this file by its path

import error_blocks as errors
import program_blocks as program
import verdict_blocks as verdicts

DOCS = Path(__file__).parent
BLOCK = re.compile(r"(<!-- generated: ([a-z_]+)(?: ([a-z0-9_-]+))? -->\n).*?(<!-- end -->)", re.DOTALL)
BLOCKS: dict[str, Callable[..., str]] = {
    function.__name__: function for function in (*verdicts.BLOCKS, *errors.BLOCKS, *program.BLOCKS)
}


def brought_up_to_date(text: str) -> str:
    """Return a document with all blocks up to date."""

    def write(found: re.Match[str]) -> str:
        begin, name, argument, end = found.groups()
        return f"{begin}\n{BLOCKS[name](*filter(None, [argument]))}\n\n{end}"

    return BLOCK.sub(write, text)


def main() -> None:
    for path in [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))]:
        old = path.read_text(encoding="utf-8")
        new = brought_up_to_date(old)
        if new != old:
            path.write_text(new, encoding="utf-8")
            print(f"updated {path.relative_to(DOCS.parent)}")


if __name__ == "__main__":
    main()
