r"""Writes the notebooks of the tutorials, without outputs, for Colab and Binder.

python tutorials/to_notebooks.py            writes tutorials/notebooks/
python tutorials/to_notebooks.py --check    fails if a notebook is not that of its script
"""

import argparse
import sys
from pathlib import Path

import nbformat
from form import FOLDER, read_script, replace_links, script_paths

REPOSITORY = "torch-geometric-tactile/torch_geometric_tactile"
GITHUB = f"https://github.com/{REPOSITORY}"
EXTRAS = "baselines,export,io,live,sim,train,viz"
BADGES = """\
[![Open in Colab](https://colab.research.google.com/assets/colab-badge.svg)]\
(https://colab.research.google.com/github/{repository}/blob/main/tutorials/notebooks/{name}.ipynb)
[![Open in Binder](https://mybinder.org/badge_logo.svg)]\
(https://mybinder.org/v2/gh/{repository}/main?labpath=tutorials%2Fnotebooks%2F{name}.ipynb)
"""
INSTALL = f"""\
# Run this first. On Colab it installs the package.
import importlib.util
import os

if importlib.util.find_spec("torch_geometric_tactile") is None:
    !git clone --quiet --depth 1 {GITHUB}.git tactile
    %pip install --quiet "./tactile[{EXTRAS}]"
    os.chdir("tactile/tutorials")
elif os.path.basename(os.getcwd()) == "notebooks":
    os.chdir("..")"""


def notebook_text(path: Path) -> str:
    r"""Returns the notebook of a script as it is written: badges below the title, a cell that
    installs the package, links to GitHub, no outputs.
    """
    notebook = read_script(path)
    replace_links(notebook, f"{GITHUB}/blob/main/docs/", f"{GITHUB}/blob/main/tutorials/notebooks/")
    title, _, rest = notebook.cells[0].source.partition("\n")
    badges = BADGES.format(repository=REPOSITORY, name=path.stem)
    notebook.cells[0].source = f"{title}\n\n{badges}{rest}"
    install = nbformat.v4.new_code_cell(INSTALL, id="install")
    notebook.cells.insert(1, install)
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    nbformat.validate(notebook)
    return nbformat.writes(notebook).rstrip("\n") + "\n"


def out_of_step(scripts: list[Path], folder: Path) -> list[str]:
    r"""Returns what is wrong with a folder of notebooks: those that are missing, differ from their
    script, or have no script.
    """
    problems = []
    for path in scripts:
        notebook = folder / f"{path.stem}.ipynb"
        if not notebook.is_file():
            problems.append(f"{notebook.name} is missing")
        elif notebook.read_text(encoding="utf-8") != notebook_text(path):
            problems.append(f"{notebook.name} is not the notebook of {path.name}")
    known = {path.stem for path in scripts}
    strays = [path.name for path in sorted(folder.glob("*.ipynb")) if path.stem not in known]
    return problems + [f"{name} has no script" for name in strays]


def main(arguments: list[str] | None = None) -> int:
    r"""Writes or checks the notebooks; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail if one differs")
    parser.add_argument("--scripts", type=Path, default=FOLDER, help="folder of the scripts")
    parser.add_argument("--out", type=Path, default=FOLDER / "notebooks", help="their folder")
    args = parser.parse_args(arguments)
    scripts = script_paths(folder=args.scripts)
    if args.check:
        problems = out_of_step(scripts, args.out)
        for problem in problems:
            print(problem, file=sys.stderr)
        if problems:
            print("run: python tutorials/to_notebooks.py", file=sys.stderr)
        return int(bool(problems))
    args.out.mkdir(parents=True, exist_ok=True)
    for path in scripts:
        (args.out / f"{path.stem}.ipynb").write_text(notebook_text(path), encoding="utf-8")
    for path in args.out.glob("*.ipynb"):
        if path.stem not in {script.stem for script in scripts}:
            path.unlink()
    print(f"{len(scripts)} notebooks in {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
