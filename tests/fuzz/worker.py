"""Runs cases in a process of their own, which may hang, grow or die."""

import contextlib
import faulthandler
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import torch
from fuzz.laws import difference
from fuzz.targets import Target

SECONDS = 5.0  # of the worker's own time
GIBI = 2**30
GROWTH = GIBI // 2  # the largest model that comes with the package takes 400 MiB


class Result(NamedTuple):
    """What came of a case."""

    outcome: str
    text: str = ""
    cause: str = ""


_ASKS_FOR_PATHS = ["-c", "import sys, json; print(json.dumps(sys.path))"]


class Watch:
    """Notes what a reader does to the machine, while it is armed."""

    _CALLS = frozenset(
        [
            *("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "os.spawn", "os.fork"),
            *("os.remove", "os.rename", "os.mkdir", "os.rmdir", "shutil.rmtree", "socket.connect"),
            *("pty.spawn", "os.symlink", "os.link", "os.truncate", "os.chmod"),
        ]
    )

    def __init__(self) -> None:
        self.armed = False
        self.seen: list[str] = []
        self._folder = tempfile.gettempdir()
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.armed:
            return
        # jsonargparse asks Python where the types of its library are.
        if event == "subprocess.Popen" and arguments[1][1:] == _ASKS_FOR_PATHS:
            return
        if event in self._CALLS:
            self.seen.append(f"{event}{arguments!r}"[:200])
        elif event == "open" and isinstance(arguments[2], int):
            path = str(arguments[0])
            # Looking for the temporaries of others that have ended makes no file. PyG writes the
            # code of a layer into the folder of temporary files.
            makes = arguments[2] & (os.O_CREAT | os.O_TRUNC | os.O_TMPFILE & ~os.O_DIRECTORY)
            own = path == self._folder or path.startswith(f"{self._folder}/torch_geometric")
            if makes and path != os.devnull and not own:
                self.seen.append(f"open{arguments!r}"[:200])

    @contextlib.contextmanager
    def on(self) -> Iterator[None]:
        self.seen, self.armed = [], True
        try:
            yield
        finally:
            self.armed = False


class Case(NamedTuple):
    """A mutated file."""

    target: Target
    path: Path
    data: bytes
    allowed: str
    base: Path
    mutation: str


class Draw(Random):
    """Random choices, which remembers the names of the functions among them."""

    def __init__(self, seed: str) -> None:
        super().__init__(seed)
        self.chosen: list[str] = []

    def choice(self, seq: Any) -> Any:
        found = super().choice(seq)
        if callable(found):
            self.chosen.append(getattr(found, "__name__", ""))
        return found


def draw_case(target: Target, whole: Path, folder: Path, seed: int, index: int) -> Case:
    """Writes case ``index`` of a seed into a folder: the same one, whatever ran before."""
    draw = Draw(f"{seed} {index}")
    files = sorted(path for path in whole.iterdir() if path.is_file())
    own = [path for path in files if path.name.endswith(target.suffix)]
    base = draw.choice(own)
    other = draw.choice(own).read_bytes()
    folder.mkdir()
    if target.suffix:
        for path in files:
            shutil.copyfile(path, folder / path.name)
    path = folder / base.name
    data = base.read_bytes()
    allowed = target.mutate(path, data, draw, other)
    return Case(target, path, data, allowed, base, " ".join(draw.chosen) or "content")


class Runner:
    """Runs cases one after another.

    Args:
        whole (Path): A folder of whole files for each target.
        scratch (Path): An empty folder, which becomes the working directory.
        seed (int): The seed.
        save (Path, optional): Where the files of failures are kept.
    """

    def __init__(self, whole: Path, scratch: Path, seed: int, save: Path | None) -> None:
        self.whole, self.scratch, self.seed, self.save = whole, scratch, seed, save
        self.watch = Watch()
        self._before: dict[Path, Any] = {}
        os.chdir(scratch)
        self._clean()  # what a process that was ended has left

    def _clean(self) -> None:
        for path in self.scratch.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()

    def run(self, target: Target, index: int) -> Result:
        """Runs a case."""
        folder = self.scratch / f"case{index}"
        try:
            case = draw_case(target, self.whole / target.name, folder, self.seed, index)
            result = self._judged(case)
            if result.outcome not in ("same", "cell", "rewritten", "error") and self.save:
                kept = self.save / f"{result.outcome} {target.name} {self.seed} {index}"
                kept = kept.with_name(kept.name.replace(" ", "_"))
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(folder, kept)
            return result
        finally:
            self._clean()

    def _judged(self, case: Case) -> Result:
        before = self._read_whole(case)
        mutated = case.path.read_bytes()
        there = sorted(os.listdir(case.path.parent))
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        found, error = None, None
        with warnings.catch_warnings(), self.watch.on():
            warnings.simplefilter("ignore")
            try:
                found = case.target.read(case.path)
            except BaseException as raised:
                error = raised
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - most) * 1024
        made = {*os.listdir(case.path.parent)} ^ {*there} | {*os.listdir()} ^ {
            case.path.parent.name
        }
        if made or self.watch.seen:
            text = ", ".join([*sorted(made), *self.watch.seen])
            return Result("ran code", text, _place(error))
        if isinstance(error, MemoryError) or grown > GROWTH:
            return Result("memory", f"{grown >> 20} MiB, {error!r}"[:500], _place(error))
        if error is not None:
            return self._error(case, error)
        outcome = case.target.judged(case.data, mutated, before, found, case.allowed)
        if outcome != "silent":
            return Result(outcome)
        change = difference(before, found)
        cause = f"{case.mutation}: {change.partition(':')[0].partition('[')[0]}"
        return Result(outcome, f"{case.mutation}: {change}", cause)

    def _error(self, case: Case, error: BaseException) -> Result:
        text = f"{type(error).__name__}: {error}"
        if not isinstance(error, ValueError | OSError):
            return Result("wrong error", text[:500], f"{type(error).__name__} {_place(error)}")
        if case.target.names_file and str(case.path.parent) not in text:
            return Result("wrong error", f"names no file: {text[:500]}", _place(error))
        return Result("error", text[:500])

    def _read_whole(self, case: Case) -> Any:
        """The reading of the file before its mutation, at the same path."""
        if case.base not in self._before:
            folder = self.scratch / "whole"
            shutil.copytree(case.base.parent, folder)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._before[case.base] = case.target.read(folder / case.base.name)
            shutil.rmtree(folder)
        return self._before[case.base]


def _place(error: BaseException | None) -> str:
    """Where an error comes from: the last line of the package."""
    if error is None:
        return ""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "torch_geometric_tactile" in frame.filename] or frames
    return f"{Path(own[-1].filename).name}:{own[-1].name}" if own else ""


def limit_memory(growth: int) -> None:
    """Lets this process take so much more address space than it has, and write no core."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    size = pages * resource.getpagesize() + growth
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def serve(
    pipe: Connection, runner_of: Any, targets: Sequence[Target], errors: str, growth: int = 4 * GIBI
) -> None:
    """Answers each number of a case with its result, until the pipe is closed. Threads of a library
    such as pyarrow reserve 1.3 GiB of address space, so that the limit must be well above."""
    with open(errors, "w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        faulthandler.enable(file)
        torch.set_num_threads(1)  # threads do not survive a fork
        runner = runner_of()
        limit_memory(growth)
        while True:
            try:
                index = pipe.recv()
            except EOFError:
                return
            try:
                result = runner.run(targets[index % len(targets)], index)
            except Exception:
                result = Result("harness", f"case {index}: {traceback.format_exc()}")
            pipe.send(tuple(result))


def own_seconds(process: int) -> float:
    """The processor time that a process has taken."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def wait_for(pipe: Connection, process: int, seconds: float = SECONDS) -> bool:
    """Waits for an answer. On a busy machine, only time that the process had counts, but no more
    than six times as much."""
    start, began = own_seconds(process), time.monotonic()
    while not pipe.poll(seconds / 5):
        waited = time.monotonic() - began
        if waited > 6 * seconds or own_seconds(process) - start > seconds:
            return False
        # Asleep for ever, and not in a queue for the processor.
        if waited > seconds and own_seconds(process) - start < 0.1 and _sleeps(process):
            return False
    return True


def _sleeps(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "S"
    except OSError:
        return False
