r"""Runs plans in parallel, and stores finished experiments."""

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
from typing import Any

import torch

from torch_geometric_tactile._parallel import keep_freed_memory, run_parallel
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._held_out import Parts, choice_cuts
from torch_geometric_tactile.experiments._run_experiment import fit
from torch_geometric_tactile.experiments._run_store import RunStore
from torch_geometric_tactile.experiments._worker import close_process, run_safely
from torch_geometric_tactile.experiments.plan import Plan, PlanRun

_logger = logging.getLogger(__name__)
_NUM_PROBE_SAMPLES = 256
_NUM_PROBE_TEST_SAMPLES = 8
_PROBE_EPOCHS = 3
_QUADRATIC_ESTIMATORS = ("rbf_svm", "signal_svm")  # time grows with the number of samples squared
# Called after each run with its experiment, the number of ended runs, and the number of runs.
OnProgress = Callable[[Experiment, int, int], None]


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

    Each finished run is stored as a JSON file in :obj:`out/runs` and not repeated, so that an
    interrupted plan can be continued. Runs with other settings, recordings, versions or source code
    of the user's classes are stored in the same folder and ignored. If the source code of a class
    is not in a file, as in a notebook, its runs are not stored and a warning is logged.

    Args:
        plan (Plan): The experiments.
        out (str or PathLike): Folder of the results.
        jobs (int, optional): Number of parallel runs. Defaults to the number in
            :func:`joblib.parallel_config`, or to one. The backend of :obj:`parallel_config` is used
            as well: machines of a Dask cluster need this package, and the recordings under the same
            path.
        only (sequence of str, optional): Patterns of names. Experiments that match no pattern are
            not trained.
        train (bool): If :obj:`False`, trains nothing and returns the stored results.
        on_progress (callable, optional): Called after each run with its experiment, the number of
            ended runs, and the number of runs.
        on_estimate (callable, optional): Called before the first run with a dictionary that maps
            the name of a model to the estimated total time of its runs in seconds, without
            parallel runs. The time is estimated by short trainings, and only for experiments with a
            choice, as in comparisons. Quick models are then run first.
        on_model (callable, optional): Called with the runs of a model after its last run.

    Raises:
        KeyboardInterrupt: On Ctrl-C. The message states the number of stored runs.
        OSError: If a process was killed, or a file cannot be written.
        ValueError: If a pattern matches no experiment, the file of a finished run is damaged, or
            :obj:`jobs` is below one.
    """
    selected_names = {cell.experiment for cell in plan.table.select(only)}
    experiments = plan.experiments
    store = RunStore(Path(out) / "runs")
    # Two names may refer to the same configuration, which is trained only once.
    by_code = {experiment.code: experiment for experiment in experiments}
    for sentence in plan.shared if experiments else ():
        _logger.warning("%s", sentence)
    _warn_unknown_sources(by_code.values())
    stored = {
        code: None if experiment.sources.unknown else store.read(experiment)
        for code, experiment in by_code.items()
    }
    results = {code: result for code, result in stored.items() if result is not None}
    stored_codes = set(results)
    selected_codes = {e.code for e in experiments if e.name in selected_names and train}
    todo = [by_code[code] for code in by_code if code in selected_codes - stored_codes]
    failed: dict[str, str] = {}
    try:
        if on_estimate is not None and train:
            with _recorded_interrupt() as interrupted:
                seconds = _estimate_seconds([e for e in todo if e.choice is not None])
            if interrupted.is_set():
                raise KeyboardInterrupt
            on_estimate(seconds)
            todo.sort(key=lambda experiment: seconds.get(experiment.name, 0.0))
        with _recorded_interrupt() as interrupted, closing(_run_experiments(todo, jobs)) as running:
            for num_ended, (experiment, result) in enumerate(running, 1):
                if "error" in result:
                    if interrupted.is_set():
                        raise KeyboardInterrupt
                    failed[experiment.label] = result["error"]
                else:
                    if _can_store(experiment):
                        store.write(experiment, result)
                    results[experiment.code] = result
                if on_progress is not None:
                    on_progress(experiment, num_ended, len(todo))
                if on_model is not None:
                    same_model = [e for e in experiments if e.name == experiment.name]
                    runs = [(e, results[e.code]) for e in same_model if e.code in results]
                    if len(runs) == len(same_model):
                        on_model(PlanRun(plan, runs, 0, {}, 0))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {_count_stored(experiments, results)} of {len(experiments)} runs are "
            "finished and kept: run the same command again to continue"
        ) from None
    except BrokenProcessPool as error:
        raise OSError(
            "a process was killed, possibly for lack of memory: run the same command with fewer "
            "jobs (finished runs are kept)"
        ) from error
    finally:
        store.clean(experiments)
    return PlanRun(
        plan,
        results=[(e, results[e.code]) for e in experiments if e.code in results],
        kept=_count_stored(experiments, stored_codes),
        failed=failed,
        missing=len(experiments) - _count_stored(experiments, results),
    )


def _warn_unknown_sources(experiments: Iterable[Experiment]) -> None:
    unknown = {name: reason for e in experiments for name, reason in e.sources.unknown.items()}
    for name, reason in unknown.items():
        _logger.warning(
            "runs with '%s' are not stored, because its source code is unknown: %s", name, reason
        )


def _can_store(experiment: Experiment) -> bool:
    # Returns whether the source code is known and was not edited during the run.
    if experiment.sources.unknown:
        return False
    if experiment.read_sources() == experiment.sources:
        return True
    _logger.warning(
        "%s is not stored: its source code (%s) was edited during the run, so that the run may "
        "have used the old or the new code; run the same command again",
        experiment.label,
        ", ".join(experiment.sources.modules),
    )
    return False


def _estimate_seconds(todo: Sequence[Experiment]) -> dict[str, float]:
    # Estimates how many seconds one process needs for all runs of each model. One experiment of
    # each model is run on few samples, and its time is extrapolated. The test parts are not read.
    num_runs = Counter(e.name for e in todo)
    threads = torch.get_num_threads()
    seconds: dict[str, float] = {}
    warm_kinds: set[bool] = set()
    for experiment in {e.name: e for e in reversed(todo)}.values():
        torch.set_num_threads(experiment.threads)
        seconds[experiment.name] = 0.0
        try:
            # The first estimator and the first network of a process spend time on imports.
            if experiment.is_estimator not in warm_kinds:
                warm_kinds.add(experiment.is_estimator)
                _estimate_run(experiment)
            seconds[experiment.name] = num_runs[experiment.name] * _estimate_run(experiment)
        except Exception as error:  # raised by a user's model: its runs report the error
            _logger.debug("no estimate for '%s': %r", experiment.name, error)
        finally:
            torch.set_num_threads(threads)
    return seconds


def _estimate_run(experiment: Experiment) -> float:
    # Estimates the seconds of one run: trainings to compare settings, and of the selected setting.
    choice = experiment.choice
    assert choice is not None
    train, test, cuts = choice_cuts(experiment, choice.repeats, choice.most_samples)
    parts = Parts(*cuts[0], train, test)
    probe_samples = _evenly_spaced(parts.fit, _NUM_PROBE_SAMPLES)
    # About half of the settings are behind the default on the first cut.
    num_alternatives = len(choice.settings) - 1
    num_selection_fits = (
        num_alternatives + len(cuts) + (len(cuts) - 1) * num_alternatives // 2
        if num_alternatives
        else 0
    )
    members = 1 if experiment.is_estimator else choice.members
    num_final_samples, num_final_fits = members * len(parts.train), members
    if choice.num_validation_cuts:
        validation_cuts = choice_cuts(experiment, choice.num_validation_cuts)[2]
        num_final_samples += members * sum(len(part) for part, _ in validation_cuts)
        num_final_fits += members * len(validation_cuts)
    if experiment.is_estimator:
        num_selection_samples = num_selection_fits * len(parts.fit)
        return _estimate_estimator_run(
            experiment, parts, probe_samples, num_selection_samples, num_final_samples
        )
    experiment = experiment.with_setting(choice.settings[0])
    probe = replace(experiment, epochs=_PROBE_EPOCHS, choice=replace(choice, members=1))
    total_seconds, step_seconds = _measure_fit(
        probe, probe_samples, _evenly_spaced(parts.val, _NUM_PROBE_TEST_SAMPLES)
    )
    # The time of the steps grows with samples and epochs; the remaining time grows with the number
    # of trainings.
    num_probe_lengths = (
        experiment.epochs
        * (num_selection_fits * len(parts.fit) + num_final_samples)
        / (_PROBE_EPOCHS * len(probe_samples))
    )
    num_fits = num_selection_fits + num_final_fits
    return (total_seconds - step_seconds) * num_fits + step_seconds * num_probe_lengths


def _estimate_estimator_run(
    experiment: Experiment,
    parts: Parts,
    probe_samples: SampleSet,
    num_selection_samples: int,
    num_final_samples: int,
) -> float:
    # Estimates the seconds from the samples of all fits that compare settings, and of later fits.
    choice = experiment.choice
    assert choice is not None
    last_setting = choice.settings[-1]  # the slowest setting of some models
    val = _evenly_spaced(parts.val, _NUM_PROBE_TEST_SAMPLES)
    final_experiment = experiment.with_setting(last_setting)
    seconds = _measure_fit(final_experiment, probe_samples, val)[0] * num_final_samples
    if num_selection_samples:
        draft = experiment.with_setting(choice.draft)
        draft_seconds = [
            _measure_fit(draft.with_setting(setting), probe_samples, val)[0]
            for setting in (choice.settings[0], last_setting)
        ]
        seconds += sum(draft_seconds) / 2 * num_selection_samples
    is_quadratic = str(experiment.model["class_path"]).endswith(_QUADRATIC_ESTIMATORS)
    growth = len(parts.fit) / len(probe_samples) if is_quadratic else 1
    return seconds / len(probe_samples) * growth


def _measure_fit(
    experiment: Experiment,
    train: SampleSet,
    test: SampleSet,
) -> tuple[float, float]:
    # Returns the total time and the time of the training steps alone, in seconds.
    start = time.perf_counter()
    step_seconds = fit(experiment, train, test).seconds
    return time.perf_counter() - start, step_seconds


def _evenly_spaced(part: SampleSet, num_samples: int) -> SampleSet:
    index = torch.linspace(0, len(part) - 1, min(num_samples, len(part))).long()
    return part[index]


@contextmanager
def _recorded_interrupt() -> Iterator[threading.Event]:
    # Yields an event that Ctrl-C sets. Libraries may replace a KeyboardInterrupt by another error;
    # for example, NumPy's comparison of structured arrays raises TypeError.
    interrupted = threading.Event()
    previous_handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous_handler):
        yield interrupted  # only the main thread may set handlers
        return

    def record(number: int, frame: FrameType | None) -> None:
        interrupted.set()
        previous_handler(number, frame)

    signal.signal(signal.SIGINT, record)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, previous_handler)


def _count_stored(experiments: Iterable[Experiment], codes: Container[str]) -> int:
    return sum(experiment.code in codes for experiment in experiments)


def _run_experiments(
    todo: Sequence[Experiment], jobs: int | None
) -> Generator[tuple[Experiment, dict[str, Any]], None, None]:
    if not todo:
        return
    try:
        with (
            keep_freed_memory(),
            closing(run_parallel(_run_numbered, enumerate(todo), jobs)) as running,
        ):
            for number, result in running:
                yield todo[number], result
    finally:
        close_process()  # with one job, this process started it


def _run_numbered(item: tuple[int, Experiment]) -> tuple[int, dict[str, Any]]:
    number, experiment = item
    return number, run_safely(experiment)
