r"""Puts a table that `tactile table` wrote into a page of results: below one of the page's
headings, or as the whole page. Its numbers go beside the page, its pictures to the images.

Examples:
    PYTHONPATH=benchmarks python studies/result_page.py --table tables/p4.md --page docs/results/p4.md
    PYTHONPATH=benchmarks python studies/result_page.py --table tables/p3-k.md --page docs/results/p3.md \
        --section "Figure 6"
"""

import re
import shutil
import sys
from pathlib import Path

from shared import parse

_KEPT = "What this page said before"


def put(table: Path, page: Path, section: str, name: str, images: Path) -> list[Path]:
    """Returns what was written. A last part of the section that is headed `_KEPT` stays."""
    title, _, body = table.read_text(encoding="utf-8").rstrip().partition("\n\n")
    text, mark = page.read_text(encoding="utf-8"), "##"
    if section:
        headings = re.findall(rf"^## {re.escape(section)}.*$", text, re.MULTILINE)
        if len(headings) != 1:
            raise ValueError(f"'section' must begin one heading of '{page}' (got '{section}')")
        title, mark = headings[0], "###"
        body = re.sub(r"^#", "##", body, flags=re.MULTILINE)
    before, _, rest = text.partition(title if section else "\n")
    old, next_section, after = rest.partition("\n## ") if section else (rest, "", "")
    kept = old.partition(f"\n{mark} {_KEPT}\n")
    parts = [before if section else "", title, "\n\n", body, "\n"]
    parts += kept[1:]
    page.write_text("".join([*parts, next_section, after]), encoding="utf-8")
    written = [page]
    for path in sorted(table.parent.glob(f"{table.stem}*")):
        rest = path.name.removeprefix(table.stem)
        target = (images if path.suffix == ".png" else page.parent) / f"{name or table.stem}{rest}"
        if rest in (".csv", "-runs.csv") or (path.suffix == ".png" and target.exists()):
            written.append(Path(shutil.copy(path, target)))
    return written


def main() -> int:
    """Writes the page."""
    arguments = parse(
        __doc__,
        {
            "--table": (Path, "the page that tactile table wrote"),
            "--page": (Path, "the page of results"),
            "--section": ("", "how its heading begins; the whole page if left out"),
            "--name": ("", "of the files with numbers and pictures; the table's if left out"),
            "--images": (Path("docs/images"), "pictures that are there are replaced"),
        },
    )
    for path in put(**vars(arguments)):
        print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
