"""Measures which of many small changes to the source the tests notice.

    python tests/mutation/run.py --mutants 200

Each mutant is tried on a copy of the checkout, with the tests of its folder (``tests/<folder>``),
first those that name its module. Libraries are imported once, and a process is forked for each
mutant. Results are added to a log, and what is in it already is not run again.
"""

import argparse
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "tests"))

from mutation.mutants import Mutant, sampled  # noqa: E402

PACKAGE = "torch_geometric_tactile"
LIBRARIES = ("torch", "torch_geometric", "sklearn", "scipy", "h5py", "lightning", "torchmetrics")
FOLDERS = (
    *("nn", "data", "io", "sensors", "transforms", "training"),
    *("datasets", "loader", "predictor", "experiments", "live", "sim"),
)


def copied(target: Path) -> None:
    """Copies what git knows of the checkout."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target / name)


def preload() -> None:
    """Imports libraries, and nothing of the package: each process imports its own mutated one."""
    for name in LIBRARIES:
        if importlib.util.find_spec(name):
            importlib.import_module(name)
    assert not any(name.split(".")[0] == PACKAGE for name in sys.modules)


def test_files(root: Path, mutant: Mutant | None, folder: str) -> list[str]:
    """The test files of a folder, those that name a module first."""
    files = sorted((root / "tests" / folder).rglob("test_*.py"))
    if mutant is None:
        return [str(file) for file in files]
    stem = Path(mutant.file).stem

    def rank(file: Path) -> int:
        text = file.read_text(encoding="utf-8")
        return -2 * (stem in file.stem) - (f".{stem} " in text)

    names = _public_names(root / mutant.file)

    def mentions(file: Path) -> int:
        text = file.read_text(encoding="utf-8")
        return -sum(name in text for name in names)

    return [str(file) for file in sorted(files, key=lambda file: (rank(file), mentions(file)))]


def _public_names(file: Path) -> list[str]:
    lines = file.read_text(encoding="utf-8").splitlines()
    words = [line.split() for line in lines if line.startswith(("def ", "class "))]
    return [line[1].partition("(")[0].rstrip(":") for line in words]


def passes(root: Path, files: list[str], seconds: float, log: Path) -> tuple[str, float]:
    """Runs tests in a forked process: "passed", "failed" or "too slow"."""
    began = time.monotonic()
    process = os.fork()
    if process == 0:
        os.setsid()
        _run_tests(root, files, log)
    while time.monotonic() - began < seconds:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return "failed" if code else "passed", time.monotonic() - began
        time.sleep(0.05)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return "too slow", time.monotonic() - began


def _run_tests(root: Path, files: list[str], log: Path) -> None:
    code = 3
    try:
        with log.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        os.chdir(root)
        libraries = (p for p in sys.path if "site-packages" in p or not p.startswith(str(ROOT)))
        sys.path[:] = [str(root), *libraries]
        os.environ["PYTHONPATH"] = str(root)
        os.environ.setdefault("TACTILE_TEST_DATA", str(ROOT.parent / "shared/data/biotacsp"))
        sys.dont_write_bytecode = True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        import pytest

        class InOrder:
            @pytest.hookimpl(trylast=True)
            def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
                """The files in their order, and last what takes seconds."""
                place = {file: i for i, file in enumerate(files)}
                items.sort(key=lambda item: place[str(item.path)])
                items.sort(key=lambda item: item.get_closest_marker("slow") is not None)

        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=line"]
        options.append(f"--basetemp={root}/../temporary")
        code = int(pytest.main([*options, *files], plugins=[InOrder()]))
    finally:
        sys.stdout.flush()
        os._exit(code)


def main() -> int:
    """Runs the mutants."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=200, help="size of the sample")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folders", default=",".join(FOLDERS), help="which of the sample to run")
    parser.add_argument("--log", type=Path, default=Path("mutants.jsonl"))
    parser.add_argument("--list", action="store_true", help="print the sample and stop")
    options = parser.parse_args()
    folders = options.folders.split(",")
    sample = sampled(ROOT, PACKAGE, FOLDERS, options.mutants, options.seed)
    sample = [mutant for mutant in sample if mutant.file.split("/")[1] in folders]
    if options.list:
        for mutant in sample:
            sys.stdout.write(f"{mutant.kind:10} {mutant.code}\n")
        return 0
    run(sample, options.log)
    return report(sample, options.log)


def run(sample: list[Mutant], log: Path) -> None:
    """Runs those that are not in the log."""
    done = {entry["code"] for entry in read_log(log)}
    preload()
    with tempfile.TemporaryDirectory(prefix="mutants_") as scratch:
        root = Path(scratch) / "copy"
        root.mkdir()
        copied(root)
        limits: dict[str, float] = {}
        for mutant in sample:
            if mutant.code in done:
                continue
            folder = mutant.file.split("/")[1]
            output = Path(scratch) / "output.txt"
            if folder not in limits:
                outcome, seconds = passes(root, test_files(root, None, folder), 3600, output)
                if outcome != "passed":
                    raise RuntimeError(f"tests/{folder} must pass: {output.read_text()[-3000:]}")
                limits[folder] = 120 + 4 * seconds
                sys.stdout.write(f"tests/{folder} pass in {seconds:.0f} s\n")
            path = root / mutant.file
            text = path.read_text(encoding="utf-8")
            path.write_text(mutant.source(text), encoding="utf-8")
            outcome, seconds = passes(
                root, test_files(root, mutant, folder), limits[folder], output
            )
            path.write_text(text, encoding="utf-8")
            words = [line for line in output.read_text(errors="replace").splitlines() if line]
            entry = {
                "code": mutant.code,
                "kind": mutant.kind,
                "outcome": outcome,
                "seconds": round(seconds, 1),
                "by": next((w for w in reversed(words) if w.startswith(("FAILED", "ERROR"))), ""),
            }
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
            sys.stdout.write(f"{outcome:8} {seconds:6.1f} s  {mutant.code}\n")
            sys.stdout.flush()


def read_log(log: Path) -> list[dict[str, str]]:
    """The entries of a log."""
    if not log.is_file():
        return []
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def report(sample: list[Mutant], log: Path) -> int:
    """Writes the score of each folder, and what was not noticed; returns the exit status."""
    outcomes = {entry["code"]: entry["outcome"] for entry in read_log(log)}
    ran = [mutant for mutant in sample if mutant.code in outcomes]
    alive = [mutant for mutant in ran if outcomes[mutant.code] == "passed"]
    by_folder = Counter(mutant.file.split("/")[1] for mutant in ran)
    alive_by_folder = Counter(mutant.file.split("/")[1] for mutant in alive)
    for mutant in alive:
        sys.stdout.write(f"not noticed: {mutant.code}\n")
    for folder, number in sorted(by_folder.items()):
        sys.stdout.write(
            f"{folder:12} {number - alive_by_folder[folder]:4} of {number:4} noticed\n"
        )
    share = 100 * (1 - len(alive) / max(1, len(ran)))
    sys.stdout.write(
        f"{'all':12} {len(ran) - len(alive):4} of {len(ran):4} noticed, {share:.1f} %\n"
    )
    return int(share < 95)


if __name__ == "__main__":
    sys.exit(main())
