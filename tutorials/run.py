r"""Runs the tutorials as notebooks, checks their outputs, and prints their times.

python tutorials/run.py               runs all tutorials
python tutorials/run.py 01 04_new_day --jobs 2
python tutorials/run.py 01 --write    also writes its notebook in tutorials/notebooks/

The executed notebooks are written to build/tutorials/. A tutorial fails if a cell raises an error,
writes to stderr, or prints a warning or a path of this machine, if a figure cell shows no picture,
if its form is wrong (see tutorials/README.md), or if it takes more processor time or memory than
the limits. A tutorial whose data can be neither found nor downloaded is skipped, and the reason is
printed.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import nbformat
from form import FOLDER, ROOT, form_problems, read_script
from form import script_paths as find_scripts
from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from nbformat import NotebookNode
from outputs import output_problems, shows_picture, without_escapes
from to_notebooks import write_notebook


@dataclass(frozen=True)
class Limits:
    r"""Limits of one tutorial: processor time in seconds, memory in bytes."""

    seconds: float = 60
    memory: float = 2e9


@dataclass
class Result:
    r"""The result of one tutorial."""

    name: str
    problems: list[str] = field(default_factory=list)
    skipped: str = ""
    wall: float = 0
    processor: float = 0
    memory: float = 0
    figures: int = 0

    @property
    def status(self) -> str:
        r"""The status: :obj:`"ok"`, :obj:`"skipped"` or :obj:`"FAILED"`."""
        return "FAILED" if self.problems else "skipped" if self.skipped else "ok"


class _Kernel(AsyncKernelManager):
    # The running interpreter, whatever kernels are installed for the user.
    @property
    def kernel_spec(self) -> KernelSpec:
        argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        quiet = "--IPKernelApp.log_level=ERROR"
        return KernelSpec(argv=[*argv, quiet], display_name="Python 3", language="python")


def run_tutorial(path: Path, out: Path, limits: Limits) -> Result:
    r"""Runs and checks one tutorial in the folder of its script. Processor time and memory are
    measured over all ended child processes, so a process must run only one tutorial.

    Args:
        path (Path): The script.
        out (Path): The folder for the executed notebook.
        limits (Limits): The limits of time and memory.
    """
    result = Result(path.stem, problems=form_problems(path))
    notebook = read_script(path)
    begin = time.monotonic()
    _execute(notebook, path.parent, limits, result)
    result.wall = time.monotonic() - begin
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    result.processor = usage.ru_utime + usage.ru_stime
    result.memory = usage.ru_maxrss * 1024
    if not result.skipped:
        result.problems += [p for cell in notebook.cells for p in output_problems(cell)]
        result.figures = sum(shows_picture(cell) for cell in notebook.cells)
    result.problems += _limit_problems(result, limits)
    notebook.metadata["processor_seconds"] = round(result.processor)  # for the gallery
    out.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, out / f"{path.stem}.ipynb")
    return result


def _execute(notebook: NotebookNode, folder: Path, limits: Limits, result: Result) -> None:
    client = NotebookClient(
        notebook,
        kernel_manager_class=_Kernel,
        resources={"metadata": {"path": str(folder)}},
        # Beside other work on the same cores, the clock runs ahead of the processor time.
        timeout=60 + int(10 * limits.seconds),
        record_timing=False,
        coalesce_streams=True,
    )
    try:
        client.execute()
    except CellExecutionError as error:
        if error.ename == "ConnectionError" and "by hand" in error.evalue:
            result.skipped = error.evalue
        else:
            told = without_escapes(error.traceback)
            result.problems.append(f"a cell raises {error.ename}: {error.evalue}\n{told}")
    except (CellTimeoutError, DeadKernelError) as error:
        result.problems.append(f"{type(error).__name__}: {error}")


def _limit_problems(result: Result, limits: Limits) -> list[str]:
    problems = []
    if result.processor > limits.seconds:
        problems.append(
            f"it takes {result.processor:.0f} s of processor time, more than {limits.seconds:g} s"
        )
    if result.memory > limits.memory:
        taken, most = result.memory / 1e9, limits.memory / 1e9
        problems.append(f"it takes {taken:.1f} GB of memory, more than {most:g} GB")
    return problems


def link_data(data: Path, folder: Path) -> None:
    r"""Fills a folder with links to all files of another folder, and sets :obj:`TACTILE_DATA` to it.
    Folders are created and processed files are left out, so that data sets write beside the links
    and read no processed files of other runs.
    """
    for path in data.rglob("*"):
        inside = path.relative_to(data)
        if path.is_dir() or "processed" in inside.parts:
            continue
        link = folder / inside
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.exists():
            link.unlink(missing_ok=True)
            link.symlink_to(path.resolve())
    os.environ["TACTILE_DATA"] = str(folder.resolve())


def header() -> str:
    r"""Returns the names of the columns of :func:`row`."""
    return f"{'tutorial':<20} {'':<8} {'CPU s':>6} {'wall s':>7} {'MB':>6} {'figures':>8}"


def row(result: Result) -> str:
    r"""Returns one line of the table of times."""
    return (
        f"{result.name:<20} {result.status:<8} {result.processor:6.1f} {result.wall:7.1f} "
        f"{result.memory / 1e6:6.0f} {result.figures:8}"
    )


def together(results: list[Result]) -> Result:
    r"""Returns the problems of all results, and the sums of their times and figures."""
    return Result(
        "together",
        problems=[f"{result.name}: {problem}" for result in results for problem in result.problems],
        wall=sum(result.wall for result in results),
        processor=sum(result.processor for result in results),
        figures=sum(result.figures for result in results),
    )


def main(arguments: list[str] | None = None) -> int:
    r"""Runs the tutorials and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="names or numbers, such as 04; all if left out")
    parser.add_argument("--jobs", type=int, default=1, help="number of tutorials that run at once")
    parser.add_argument(
        "--limit", type=float, default=Limits.seconds, help="processor time of each in seconds"
    )
    parser.add_argument("--total", type=float, default=420, help="processor time of all in seconds")
    parser.add_argument("--memory", type=float, default=2, help="memory of each in GB")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "tutorials", help="results")
    parser.add_argument("--scripts", type=Path, default=FOLDER, help="folder of the scripts")
    parser.add_argument(
        "--write", action="store_true", help="write those without a problem to tutorials/notebooks"
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=ROOT.parent / "shared" / "data",
        help="recordings that are used in place of a download, unless TACTILE_DATA is set",
    )
    args = parser.parse_args(arguments)
    try:
        scripts = find_scripts(args.names, args.scripts)
    except ValueError as error:
        parser.error(str(error))
    if args.data.is_dir() and "TACTILE_DATA" not in os.environ:
        link_data(args.data, args.out / "data")
    # What tqdm says in a kernel without ipywidgets is no fault of a tutorial.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:IProgress not found")
    limits = Limits(args.limit, args.memory * 1e9)
    # A new process for each, so that its children are those of one tutorial.
    with ProcessPoolExecutor(
        args.jobs, mp_context=multiprocessing.get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        futures = [pool.submit(run_tutorial, path, args.out, limits) for path in scripts]
        print(header(), flush=True)
        results = []
        for future in futures:
            results.append(future.result())
            print(row(results[-1]), flush=True)
    every = together(results)
    every.problems += [f"together: {p}" for p in _limit_problems(every, Limits(args.total))]
    print(row(every))
    for problem in every.problems:
        print(f"\n{problem}", file=sys.stderr)
    for result in results:
        if result.skipped:
            print(f"\n{result.name} skipped: {result.skipped}")
    if args.write:
        for path, result in zip(scripts, results, strict=True):
            if result.status == "ok":
                write_notebook(path, args.out / f"{path.stem}.ipynb", args.scripts / "notebooks")
    return int(bool(every.problems))


if __name__ == "__main__":
    sys.exit(main())
