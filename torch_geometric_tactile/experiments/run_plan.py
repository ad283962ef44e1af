r"""Running a plan: on many processes, finished experiments kept."""

import logging
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import torch

from torch_geometric_tactile._parallel import keep_freed_memory, run_parallel
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._held_out import Parts, choice_cuts
from torch_geometric_tactile.experiments._run_experiment import fit
from torch_geometric_tactile.experiments._run_store import RunStore
from torch_geometric_tactile.experiments._worker import close_process, run_safely
from torch_geometric_tactile.experiments.plan import Plan

_logger = logging.getLogger(__name__)
_PROBE = 256  # samples
_PROBE_EPOCHS = 3
_SQUARE = ("rbf_svm", "signal_svm")  # their time grows with the square of the samples
# Called with each run that ended, how many ended so far, and how many are to be run.
OnProgress = Callable[[Experiment, int, int], None]


class PlanRun(NamedTuple):
    r"""What became of a plan: its finished experiments and their results, how many of them were
    :obj:`kept` from before, what :obj:`failed` and why, and how many are :obj:`missing`.
    """

    plan: Plan
    results: list[tuple[Experiment, dict[str, Any]]]
    kept: int
    failed: dict[str, str]
    missing: int

    def describe(self) -> str:
        r"""Returns what became of it in one line."""
        total = len(self.results) + self.missing
        kept = f" ({self.kept} kept from before)" if self.kept else ""
        missing = f", {self.missing} missing" if self.missing else ""
        done = len(self.results)
        return f"{self.plan.table.name}: {done} of {total} runs finished{kept}{missing}"


def run_plan(
    plan: Plan,
    out: PathLike = "tables",
    jobs: int | None = None,
    *,
    only: Sequence[str] | None = None,
    train: bool = True,
    on_progress: OnProgress | None = None,
    on_estimate: Callable[[dict[str, float]], None] | None = None,
    on_model: Callable[[PlanRun], None] | None = None,
) -> PlanRun:
    r"""Trains and tests the experiments of a plan that are not finished.

    A finished run is a JSON file in :obj:`out/runs`, whole or absent, and is not run again: a run
    that was stopped or killed goes on where it was. Runs with other settings, recordings or
    versions, or of other source code of the user's own classes, have other files in the same folder
    and do not get into the table. Runs of own classes whose source code is in no file, such as
    those of a notebook, are not kept, and a warning is logged.

    Args:
        plan (Plan): What is to be run.
        out (str or PathLike): Folder of the results.
        jobs (int, optional): Number of runs at a time; that of :func:`joblib.parallel_config`, or
            else one, if left out. Its backend is obeyed as well, such as that of a Dask cluster,
            whose machines must have this package, and the recordings under the same path.
        only (sequence of str, optional): Train only experiments with names like these patterns.
        train (bool): Whether to train what is missing; otherwise the result is of what is there.
        on_progress (callable, optional): Called with each run that ended, how many ended so far,
            and how many are to be run.
        on_estimate (callable, optional): Called before the first run with the seconds, about, that
            the runs of each experiment with a choice, as those of comparisons, will take one after
            the other, by its name. They are measured on a short probe, and the quick ones are run
            first.
        on_model (callable, optional): Called with the runs of one experiment when the last of them
            is finished.

    Raises:
        KeyboardInterrupt: On Ctrl-C; the message tells how many runs are kept.
        OSError: If a process was killed, or a file cannot be written.
        ValueError: If a pattern fits no experiment, a file of a finished run is damaged, or
            :obj:`jobs` is below one.
    """
    chosen = {cell.experiment for cell in plan.table.select(only)}
    experiments = plan.experiments
    store = RunStore(Path(out) / "runs")
    # Two names may stand for one configuration, which is trained once.
    different = {experiment.code: experiment for experiment in experiments}
    for sentence in plan.shared if experiments else ():
        _logger.warning("%s", sentence)
    _warn_of_unknown_sources(different.values())
    found = {
        code: None if experiment.sources.unknown else store.read(experiment)
        for code, experiment in different.items()
    }
    results = {code: result for code, result in found.items() if result is not None}
    kept = set(results)
    wanted = {experiment.code for experiment in experiments if experiment.name in chosen and train}
    todo = [different[code] for code in different if code in wanted - kept]
    failed: dict[str, str] = {}
    try:
        if on_estimate is not None and train:
            with _noticed_stop() as stopped:
                seconds = _estimate_seconds([e for e in todo if e.choice is not None])
            if stopped.is_set():
                raise KeyboardInterrupt
            on_estimate(seconds)
            todo.sort(key=lambda experiment: seconds.get(experiment.name, 0.0))
        with _noticed_stop() as stopped, closing(_run(todo, jobs)) as running:
            for ended, (experiment, result) in enumerate(running, 1):
                if "error" in result:
                    if stopped.is_set():
                        raise KeyboardInterrupt
                    failed[experiment.label] = result["error"]
                else:
                    if _may_keep(experiment):
                        store.write(experiment, result)
                    results[experiment.code] = result
                if on_progress is not None:
                    on_progress(experiment, ended, len(todo))
                if on_model is not None:
                    mine = [e for e in experiments if e.name == experiment.name]
                    runs = [(e, results[e.code]) for e in mine if e.code in results]
                    if len(runs) == len(mine):
                        on_model(PlanRun(plan, runs, 0, {}, 0))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {_count(experiments, results)} of {len(experiments)} runs are finished and "
            "kept: the same command goes on"
        ) from None
    except BrokenProcessPool as error:
        raise OSError(
            "a process was killed, perhaps for lack of memory: run the same command with fewer "
            "jobs (finished runs are kept)"
        ) from error
    finally:
        store.clean(experiments)
    return PlanRun(
        plan,
        results=[(e, results[e.code]) for e in experiments if e.code in results],
        kept=_count(experiments, kept),
        failed=failed,
        missing=len(experiments) - _count(experiments, results),
    )


def _warn_of_unknown_sources(experiments: Iterable[Experiment]) -> None:
    unknown = {name: reason for e in experiments for name, reason in e.sources.unknown.items()}
    for name, reason in unknown.items():
        _logger.warning(
            "runs with '%s' are not kept, since its source code is not known: %s", name, reason
        )


def _may_keep(experiment: Experiment) -> bool:
    # Whether the source code is known, and was not edited during the run.
    if experiment.sources.unknown:
        return False
    if experiment.read_sources() == experiment.sources:
        return True
    _logger.warning(
        "%s is not kept: its source code (%s) was edited during the run, which may be of the old "
        "code or of the new; run the same command again",
        experiment.label,
        ", ".join(experiment.sources.modules),
    )
    return False


def _estimate_seconds(todo: Sequence[Experiment]) -> dict[str, float]:
    # For how many seconds one process is busy with the runs of each model, about: each is tried
    # on a few samples, and its time is extrapolated. The test parts are not read.
    count = Counter(e.name for e in todo)
    threads = torch.get_num_threads()
    found: dict[str, float] = {}
    warm: set[bool] = set()
    for experiment in {e.name: e for e in reversed(todo)}.values():
        torch.set_num_threads(experiment.threads)
        found[experiment.name] = 0.0
        try:
            if experiment.is_estimator not in warm:  # the first of a kind imports much
                warm.add(experiment.is_estimator)
                _of_run(experiment)
            found[experiment.name] = count[experiment.name] * _of_run(experiment)
        except Exception as error:  # of a model of the user's own: its runs tell
            _logger.debug("no estimate for '%s': %r", experiment.name, error)
        finally:
            torch.set_num_threads(threads)
    return found


def _of_run(experiment: Experiment) -> float:
    choice = experiment.choice
    assert choice is not None
    train, test, cuts = choice_cuts(experiment, choice.repeats, choice.most_samples)
    parts = Parts(*cuts[0], train, test)
    few = _some(parts.fit, _PROBE)
    # About half of the settings are behind the default on the first cut.
    others = len(choice.settings) - 1
    tried = others + len(cuts) + (len(cuts) - 1) * others // 2 if others else 0
    members = 1 if experiment.is_estimator else choice.members
    trained, num_trained = members * len(parts.train), members
    if choice.num_validation_cuts:
        validation = choice_cuts(experiment, choice.num_validation_cuts)[2]
        trained += members * sum(len(part) for part, _ in validation)
        num_trained += members * len(validation)
    if experiment.is_estimator:
        return _of_estimator(experiment, parts, few, tried * len(parts.fit), trained)
    experiment = experiment.with_setting(choice.settings[0])
    probe = replace(experiment, epochs=_PROBE_EPOCHS, choice=replace(choice, members=1))
    whole, steps = _seconds(probe, few, _some(parts.val, 8))
    epochs = experiment.epochs * (tried * len(parts.fit) + trained) / (_PROBE_EPOCHS * len(few))
    return (whole - steps) * (tried + num_trained) + steps * epochs


def _of_estimator(
    experiment: Experiment, parts: Parts, few: SampleSet, num_tried: int, num_trained: int
) -> float:
    # Of so many samples to compare settings with, and so many to train the chosen one.
    choice = experiment.choice
    assert choice is not None
    last = choice.settings[-1]  # slower for some
    val = _some(parts.val, 8)
    seconds = _seconds(experiment.with_setting(last), few, val)[0] * num_trained
    if num_tried:
        draft = experiment.with_setting(choice.draft)
        ends = [_seconds(draft.with_setting(s), few, val)[0] for s in (choice.settings[0], last)]
        seconds += sum(ends) / 2 * num_tried
    is_square = str(experiment.model["class_path"]).endswith(_SQUARE)
    return seconds / len(few) * (len(parts.fit) / len(few) if is_square else 1)


def _seconds(
    experiment: Experiment,
    train: SampleSet,
    other: SampleSet,
) -> tuple[float, float]:
    # In all, and in the steps alone.
    start = time.perf_counter()
    seconds = fit(experiment, train, other).seconds
    return time.perf_counter() - start, seconds


def _some(part: SampleSet, count: int) -> SampleSet:
    index = torch.linspace(0, len(part) - 1, min(count, len(part))).long()
    return part[index]


@contextmanager
def _noticed_stop() -> Iterator[threading.Event]:
    # A library may answer Ctrl-C with an error of its own: NumPy's comparison of structured arrays
    # raises TypeError, and the KeyboardInterrupt is lost.
    stopped = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield stopped
        return

    def notice(number: int, frame: FrameType | None) -> None:
        stopped.set()
        before(number, frame)

    signal.signal(signal.SIGINT, notice)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, before)


def _count(experiments: Iterable[Experiment], codes: Container[str]) -> int:
    return sum(experiment.code in codes for experiment in experiments)


def _run(
    todo: Sequence[Experiment], jobs: int | None
) -> Generator[tuple[Experiment, dict[str, Any]], None, None]:
    if not todo:
        return
    try:
        with (
            keep_freed_memory(),
            closing(run_parallel(_numbered, enumerate(todo), jobs)) as running,
        ):
            for number, result in running:
                yield todo[number], result
    finally:
        close_process()  # with one job it is ours


def _numbered(item: tuple[int, Experiment]) -> tuple[int, dict[str, Any]]:
    number, experiment = item
    return number, run_safely(experiment)
