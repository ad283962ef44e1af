r"""Writes the notebooks of the tutorials after a change of their text, and keeps their outputs.

python tutorials/to_notebooks.py            writes tutorials/notebooks/
python tutorials/to_notebooks.py --check    fails if a notebook differs from its script

After a change of code, run the tutorial: python tutorials/run.py NAME --write
"""

import argparse
import contextlib
import sys
from pathlib import Path

import nbformat
from form import FOLDER, first_line, read_script, replace_links, script_paths
from nbformat import NotebookNode
from outputs import output_problems, to_stored

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


def with_outputs(path: Path, executed: Path) -> NotebookNode:
    r"""Returns the notebook of a script with the outputs of an executed notebook.

    Args:
        path (Path): The script.
        executed (Path): The executed notebook, with or without the cell that installs the package.

    Raises:
        ValueError: If the notebook is missing, or its code differs from that of the script.
    """
    notebook = read_script(path)
    run_again = f"run: python tutorials/run.py {path.stem} --write"
    if not executed.is_file():
        raise ValueError(f"{executed.name} is missing; {run_again}")
    old = nbformat.read(executed, as_version=4)
    new_cells, old_cells = code_cells(notebook), code_cells(old)
    if [cell.source for cell in new_cells] != [cell.source for cell in old_cells]:
        raise ValueError(f"the code of {executed.name} is not that of {path.name}; {run_again}")
    for new, cell in zip(new_cells, old_cells, strict=True):
        new.outputs, new.execution_count = cell.outputs, cell.execution_count
    notebook.metadata["processor_seconds"] = old.metadata.get("processor_seconds")
    return notebook


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    r"""Returns the code cells of a tutorial, without the one that installs the package."""
    return [
        cell for cell in notebook.cells if cell.cell_type == "code" and cell.get("id") != "install"
    ]


def notebook_text(path: Path, executed: Path) -> str:
    r"""Returns the text of the committed notebook of a script, with badges below the title, a cell
    that installs the package, links to GitHub, and the outputs of an executed notebook.
    """
    notebook = with_outputs(path, executed)
    replace_links(notebook, f"{GITHUB}/blob/main/docs/", f"{GITHUB}/blob/main/tutorials/notebooks/")
    title, _, rest = notebook.cells[0].source.partition("\n")
    badges = BADGES.format(repository=REPOSITORY, name=path.stem)
    notebook.cells[0].source = f"{title}\n\n{badges}{rest}"
    install = nbformat.v4.new_code_cell(INSTALL, id="install")
    notebook.cells.insert(1, install)
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    nbformat.validate(notebook)
    return nbformat.writes(notebook).rstrip("\n") + "\n"


def write_notebook(path: Path, executed: Path, folder: Path) -> None:
    r"""Writes the notebook of a script with the outputs of an executed one.

    Args:
        path (Path): The script.
        executed (Path): The executed notebook. Its pictures are stored with fewer colours.
        folder (Path): The folder of the notebooks.
    """
    notebook = nbformat.reads(notebook_text(path, executed), as_version=4)
    for cell in code_cells(notebook):
        cell.outputs = [to_stored(output) for output in cell.outputs]
    folder.mkdir(parents=True, exist_ok=True)
    text = nbformat.writes(notebook).rstrip("\n") + "\n"
    (folder / f"{path.stem}.ipynb").write_text(text, encoding="utf-8")


def out_of_step(scripts: list[Path], folder: Path) -> list[str]:
    r"""Returns the problems of a folder of notebooks: notebooks that are missing, differ from their
    script, have wrong outputs or cells that were not run, or have no script.
    """
    problems = []
    for path in scripts:
        notebook = folder / f"{path.stem}.ipynb"
        try:
            text = notebook_text(path, notebook)
        except ValueError as error:
            problems.append(str(error))
            continue
        if notebook.read_text(encoding="utf-8") != text:
            told = "run: python tutorials/to_notebooks.py"
            problems.append(f"{notebook.name} is not the notebook of {path.name}; {told}")
        for cell in code_cells(nbformat.reads(text, as_version=4)):
            problems += [f"{notebook.name}: {problem}" for problem in output_problems(cell)]
            if cell.execution_count is None:
                problems.append(f"{notebook.name}: the cell '{first_line(cell)}' was not run")
    known = {path.stem for path in scripts}
    strays = [path.name for path in sorted(folder.glob("*.ipynb")) if path.stem not in known]
    return problems + [f"{name} has no script" for name in strays]


def main(arguments: list[str] | None = None) -> int:
    r"""Writes or checks the notebooks and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail if one differs")
    parser.add_argument("--scripts", type=Path, default=FOLDER, help="folder of the scripts")
    args = parser.parse_args(arguments)
    scripts, folder = script_paths(folder=args.scripts), args.scripts / "notebooks"
    if not args.check:
        for path in folder.glob("*.ipynb"):
            if path.stem not in {script.stem for script in scripts}:
                path.unlink()
        for path in scripts:
            with contextlib.suppress(ValueError):  # which is printed below
                write_notebook(path, folder / f"{path.stem}.ipynb", folder)
    problems = out_of_step(scripts, folder)
    for problem in problems:
        print(problem, file=sys.stderr)
    if not problems:
        print(f"{len(scripts)} notebooks in {folder}")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
