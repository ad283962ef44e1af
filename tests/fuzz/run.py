"""Attacks every reader with mutated files, and prints what came of it.

    python tests/fuzz/run.py --cases 100000
    python tests/fuzz/run.py --only 12345 --save /tmp/failures

Case number i of a seed is the same file in every run. What is allowed is written down in
``laws.py``. The exit status is 1 if anything else came of a case.
"""

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_any
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(TESTS))
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if not any(path and (Path(path) / "torch_geometric_tactile").is_dir() for path in paths):
        sys.path.insert(0, str(TESTS.parent))  # the package beside, not an installed one

import torch  # noqa: E402
from fuzz.laws import ALLOWED, FAILURES, OUTCOMES  # noqa: E402
from fuzz.targets import Target, schedule  # noqa: E402
from fuzz.worker import Result, Runner, draw_case, serve, wait_for  # noqa: E402

FORK = multiprocessing.get_context("fork")


class Worker:
    """A process that runs cases, and is replaced when it hangs or dies.

    Args:
        runner_of (callable): Makes the runner, in the process.
        targets (list of Target): The targets of case 0, 1, ...
        errors (str): A file for what the process writes before it dies.
        seconds (float): The time limit of a case.
    """

    def __init__(self, runner_of: object, targets: list[Target], errors: str, seconds: float = 5):
        self._arguments = (runner_of, targets, errors)
        self.errors, self.seconds = errors, seconds
        self.index = -1
        self._start()

    def _start(self) -> None:
        self.pipe, theirs = FORK.Pipe()
        self.process = FORK.Process(target=serve, args=(theirs, *self._arguments), daemon=True)
        self.process.start()
        theirs.close()

    def ask(self, index: int) -> None:
        """Begins a case."""
        self.index = index
        self.pipe.send(index)

    def answer(self) -> Result:
        """The result of the case."""
        if not wait_for(self.pipe, self.process.pid or 0, self.seconds):
            self._replace()
            return Result("hang", f"more than {self.seconds} s", "hang")
        try:
            result = Result(*self.pipe.recv())
        except (EOFError, ConnectionResetError):
            self.process.join()
            code = self.process.exitcode
            words = Path(self.errors).read_text(errors="replace").splitlines()
            places = [line.strip() for line in words if line.lstrip().startswith("File")]
            self._replace()
            return Result("crash", f"exit status {code}", f"{code} {' < '.join(places[:3])}")
        if result.outcome == "harness":
            raise RuntimeError(result.text)
        if result.outcome == "memory":  # what it has taken, it keeps
            self._replace()
        return result

    def _replace(self) -> None:
        self.close()
        self._start()

    def close(self) -> None:
        """Ends the process."""
        self.pipe.close()
        if self.process.is_alive():
            self.process.kill()
        self.process.join()


def make_whole(targets: list[Target], folder: Path) -> None:
    """Writes the whole files, in a process of its own: threads and fork do not go together."""
    for target in targets:
        part = folder / target.name
        part.mkdir()
        target.make(part)
        for path in part.iterdir():
            if path.is_dir():
                shutil.rmtree(path)


def _make_in_child(targets: list[Target], folder: Path) -> None:
    torch.set_num_threads(1)  # threads do not survive a fork
    make_whole(targets, folder)


def preload() -> None:
    """Imports what the workers need, before they are forked."""
    import zstandard  # noqa: F401


def attack(
    targets: list[Target],
    cases: list[int],
    seed: int = 0,
    workers: int = 1,
    save: Path | None = None,
    seconds: float = 5,
    progress: bool = False,
) -> list[tuple[int, Result]]:
    """Runs cases, and returns their results in the order of their numbers.

    Args:
        targets (list of Target): The targets of case 0, 1, ..., over and over.
        cases (list of int): The numbers of the cases.
        seed (int): The seed.
        workers (int): Number of processes.
        save (Path, optional): Where the files of failures are kept.
        seconds (float): The time limit of a case.
        progress (bool): Whether to write a line now and then.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz_") as folder:
        root = Path(folder)
        whole = root / "whole"
        whole.mkdir()
        once = list(
            {targets[i % len(targets)].name: targets[i % len(targets)] for i in cases}.values()
        )
        maker = FORK.Process(target=_make_in_child, args=(once, whole))
        maker.start()
        maker.join()
        if maker.exitcode:
            raise RuntimeError("the whole files could not be made")
        team = []
        for number in range(max(1, min(workers, len(cases)))):
            scratch = root / f"worker{number}"
            scratch.mkdir()
            runner_of = partial(Runner, whole, scratch, seed, save)
            team.append(Worker(runner_of, targets, f"{scratch}.txt", seconds))
        try:
            found = _distributed(team, cases, progress)
        finally:
            for worker in team:
                worker.close()
        if save is not None:
            for index, result in found:
                if result.outcome in ("crash", "hang"):
                    target = targets[index % len(targets)]
                    name = f"{result.outcome}_{target.name}_{seed}_{index}".replace(" ", "_")
                    shutil.rmtree(save / name, ignore_errors=True)
                    draw_case(target, whole / target.name, save / name, seed, index)
    return sorted(found)


def _distributed(team: list[Worker], cases: list[int], progress: bool) -> list[tuple[int, Result]]:
    found: list[tuple[int, Result]] = []
    waiting = iter(cases)
    busy: dict[Connection, Worker] = {}
    began = last = time.monotonic()
    for worker, index in zip(team, waiting, strict=False):
        worker.ask(index)
        busy[worker.pipe] = worker
    while busy:
        ready = wait_any([*busy], timeout=1.0)
        # Without an answer: whoever has taken too long is found out in `answer`.
        for pipe in ready or [*busy]:
            worker = busy.pop(pipe)  # type: ignore[arg-type]
            found.append((worker.index, worker.answer()))
            index = next(waiting, None)
            if index is not None:
                worker.ask(index)
                busy[worker.pipe] = worker
        if progress and time.monotonic() - last > 15:
            last = time.monotonic()
            bad = sum(result.outcome in FAILURES for _, result in found)
            sys.stderr.write(
                f"{len(found)} cases, {bad} failures, {last - began:.0f} s, "
                f"{1000 * (last - began) / len(found):.1f} ms a case\n"
            )
    return found


def print_table(targets: list[Target], found: list[tuple[int, Result]]) -> None:
    """Writes rows of targets, columns of outcomes."""
    counts = Counter((targets[i % len(targets)].name, result.outcome) for i, result in found)
    names = sorted({name for name, _ in counts})
    widths = [max(6, len(outcome)) for outcome in OUTCOMES]
    head = " ".join(name.rjust(width) for name, width in zip(OUTCOMES, widths, strict=True))
    sys.stdout.write(f"{'':28} {'cases':>6} {head}\n")
    for name in [*names, "all"]:
        row = [
            sum(n for (t, o), n in counts.items() if o == outcome and name in (t, "all"))
            for outcome in OUTCOMES
        ]
        cells = " ".join(str(n).rjust(width) for n, width in zip(row, widths, strict=True))
        sys.stdout.write(f"{name:28} {sum(row):6} {cells}\n")


def print_failures(targets: list[Target], found: list[tuple[int, Result]], seed: int) -> None:
    """Writes each distinct cause once, with how to see it again."""
    causes: dict[tuple[str, str, str], list[tuple[int, Result]]] = {}
    for index, result in found:
        if result.outcome not in ALLOWED:
            key = (targets[index % len(targets)].name, result.outcome, result.cause)
            causes.setdefault(key, []).append((index, result))
    for (name, outcome, cause), cases in sorted(causes.items(), key=lambda item: -len(item[1])):
        index, result = cases[0]
        numbers = " ".join(str(i) for i, _ in cases[:8])
        sys.stdout.write(
            f"\n{name}: {outcome}, {len(cases)} times ({cause})\n    {result.text[:300]!r}\n"
            f"    python tests/fuzz/run.py --seed {seed} --only {index}   (also {numbers})\n"
        )


def main(arguments: list[str] | None = None) -> int:
    """Runs the attack."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000, help="number of cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--targets", default="", help="names of targets, with commas between them")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of single cases")
    parser.add_argument("--save", type=Path, help="folder for the files of failures")
    options = parser.parse_args(arguments)
    preload()
    targets = schedule()
    cases = options.only or list(range(options.cases))
    if options.targets:
        # Commas are in names too: any target that begins as one of the given ones.
        starts = tuple(part.strip() for part in options.targets.split(","))
        cases = [i for i in cases if targets[i % len(targets)].name.startswith(starts)]
    if options.save is not None:
        options.save.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    found = attack(targets, cases, options.seed, options.workers, options.save, progress=True)
    spent = time.monotonic() - began
    print_failures(targets, found, options.seed)
    if options.only:
        for index, result in found:
            sys.stdout.write(f"{index} {targets[index % len(targets)].name}: {result}\n")
    sys.stdout.write("\n")
    print_table(targets, found)
    sys.stdout.write(
        f"seed {options.seed}, {spent:.0f} s, {1000 * spent / len(found):.1f} ms a case\n"
    )
    return int(any(result.outcome not in ALLOWED for _, result in found))


if __name__ == "__main__":
    sys.exit(main())
