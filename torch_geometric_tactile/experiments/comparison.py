r"""Comparisons of models on one data set: settings, plan and scores."""

import math
import statistics
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.experiments._compared_models import (
    FLOOR,
    ComparedModel,
    check_model_names,
    find_model,
    select_models,
)
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._held_out import compared_protocol, mean_training_size
from torch_geometric_tactile.experiments._score_units import (
    ConstantAnswer,
    ScoreUnits,
    comparison_splits,
)
from torch_geometric_tactile.experiments._scores import MIN_PAIRS
from torch_geometric_tactile.experiments.differences import (
    Difference,
    paired_difference,
    run_difference,
)
from torch_geometric_tactile.experiments.plan import Plan, PlanRun, Settings, list_experiments
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import OnProgress, run_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.tables import Table, TableProtocol

_CLASS_METRICS = ("accuracy", "balanced_accuracy", "f1")
_NUMBER_METRICS = ("mae", "rmse", "r2")
# The share of the training samples on which candidate settings are trained. The training recipe of
# a network depends on the number of these samples.
_FIT_SHARE = 0.8
_TOLERANCE = 0.01  # one percentage point
_TOLERANCES = {"mae": 0.02}  # a share of the smallest error


@dataclass(frozen=True)
class ComparisonSettings:
    r"""The models, splits and scores of a comparison.

    Args:
        models (tuple of str, optional): Names of the models, or import paths of your own models: a
            network class, or a class or function that returns a scikit-learn estimator. Defaults to
            all stock models that fit the data.
        by (str, optional): The unit that a split keeps together, as in
            :class:`~torch_geometric_tactile.data.Protocol`: :obj:`"trial"`, :obj:`"group"`,
            :obj:`"session"`, :obj:`"frame"` or an attribute of the samples, such as
            :obj:`"person"`. With :obj:`"given"`, the parts of the data set are used. Defaults to
            the trial. Samples without trials are split by group if three or more groups share their
            classes, otherwise by frame; a warning then names the unit.
        folds (int): Number of folds. For each seed, each fold is the test part once.
        seeds (int): Number of random draws of the folds, or of training runs on given parts.
        metric (str, optional): The score by which settings and models are selected:
            :obj:`"accuracy"` (the default for classes), :obj:`"balanced_accuracy"` (training then
            weights classes equally), or :obj:`"mae"` (the default for numbers).
        epochs (int, optional): Epochs of a network. The default depends on the number of samples.
        members (int, optional): Number of networks that are trained on each training part and
            averaged. Defaults to three, or to one with more than 1,000 training samples.
        tare (dict, optional): Arguments of :class:`~torch_geometric_tactile.transforms.Tare`, such
            as :obj:`{"key": "trial", "first": 10}` if each trial begins at rest. The frames are
            tared before windows are cut.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of each run.
        tolerance (float, optional): The largest loss of score for which a simpler model is
            recommended instead of the best. Accuracies are from 0 to 1, so the default of 0.01 is
            one percentage point. For :obj:`"mae"`, it is a share of the smallest error, and the
            default is 0.02.

    Raises:
        ValueError: If a name is unknown, or a number is too small.
    """

    models: tuple[str, ...] | None = None
    by: str | None = None
    folds: int = 5
    seeds: int = 1
    metric: str | None = None
    epochs: int | None = None
    members: int | None = None
    tare: Mapping[str, Any] | None = None
    accelerator: str = "cpu"
    threads: int = 1
    tolerance: float | None = None

    def __post_init__(self) -> None:
        need_argument(
            self.tolerance is None or 0 <= self.tolerance < 1,
            "tolerance",
            "must be at least 0 and below 1",
            self.tolerance,
        )
        if self.models is not None:
            check_model_names(self.models)
        if self.metric not in (None, "accuracy", "balanced_accuracy", "mae"):
            raise ArgumentError(
                Argument("metric"),
                f" must be 'accuracy', 'balanced_accuracy' or 'mae' (got '{self.metric}')",
            )
        need_argument(
            self.members is None or self.members >= 1, "members", "must be at least 1", self.members
        )
        self.plan_settings()  # checks the numbers

    def plan_settings(self) -> Settings:
        r"""Returns the settings that comparisons share with tables."""
        return Settings(
            seeds=self.seeds,
            epochs=self.epochs,
            folds=self.folds,
            accelerator=self.accelerator,
            threads=self.threads,
        )


class Summary(NamedTuple):
    r"""The mean and the standard deviation over splits, or over the seeds of given parts. The
    standard deviation of a single value is NaN.
    """

    mean: float
    sd: float


@dataclass(frozen=True)
class ModelResult:
    r"""Scores of one model over all splits, or over all seeds of given parts.

    Args:
        model (ComparedModel): The model.
        scores (dict): Mean and standard deviation of each score, by its name.
        difference (Difference, optional): The difference from the best plain model; :obj:`None` for
            the best plain model.
        num_parameters (float, optional): Mean number of weights of a network, or of fitted numbers
            of an estimator.
        seconds (float): Mean time to select settings and train on one split, in seconds.
        milliseconds (float): Mean time to predict one sample, in milliseconds.
        chosen (tuple of dict): The selected setting of each split, with its index and the
            validation scores.
        validation (float, optional): With given parts, the mean validation score over the
            validation parts and seeds.
    """

    model: ComparedModel
    scores: dict[str, Summary]
    difference: Difference | None
    num_parameters: float | None
    seconds: float
    milliseconds: float
    chosen: tuple[dict[str, Any], ...]
    validation: float | None = None


@dataclass(frozen=True)
class Comparison:
    r"""Scores of all models of a comparison.

    Args:
        run (PlanRun): The runs.
        metric (str): The score that is compared.
        results (tuple of ModelResult): Results of the models that are finished on every split, in
            the order of the models.
        best_plain (str, optional): Name of the best plain model by :meth:`merit`.
        units (ScoreUnits): The units that are new in the test parts. Each unit is one observation.
        constant (ConstantAnswer): The most frequent class, or the mean, and its score.
        tolerance (float): The largest loss of score (for :obj:`"mae"`, the largest increase of the
            error) for which a simpler model is recommended instead of the best.
    """

    run: PlanRun
    metric: str
    results: tuple[ModelResult, ...]
    best_plain: str | None
    units: ScoreUnits
    constant: ConstantAnswer
    tolerance: float

    @property
    def metrics(self) -> tuple[str, ...]:
        r"""The names of the scores."""
        return _NUMBER_METRICS if self.metric == "mae" else _CLASS_METRICS

    @property
    def has_given_parts(self) -> bool:
        r"""Whether all models are tested on the test part of the data set."""
        return all(e.protocol.by == "given" for e in self.run.plan.experiments)

    @property
    def num_splits(self) -> int:
        r"""The number of splits on which models are compared. Given parts are a single split for
        any number of seeds.
        """
        splits = {(e.seed, e.fold) for e in self.run.plan.experiments}
        return 1 if self.has_given_parts else len(splits)

    @property
    def num_seeds(self) -> int:
        r"""The number of random draws of the folds, or of training runs on given parts."""
        return len({e.seed for e in self.run.plan.experiments})

    @property
    def is_validated(self) -> bool:
        r"""Whether models are ranked by validation scores instead of test scores, as with given
        parts.
        """
        return any(result.validation is not None for result in self.results)

    @property
    def best(self) -> ModelResult | None:
        r"""The model with the highest :meth:`merit`. Of equally good models, the smallest."""

        def rank(result: ModelResult) -> tuple[float, float, float]:
            size = math.inf if result.num_parameters is None else result.num_parameters
            return -round(self.merit(result), 12), size, result.milliseconds

        return min(self.results, key=rank, default=None)

    def merit(self, result: ModelResult) -> float:
        r"""Returns the score by which models are ranked, which is higher for better models. It is
        the validation score if :obj:`is_validated`, otherwise :meth:`goodness`.

        Args:
            result (ModelResult): The result of a model.
        """
        if not self.is_validated:
            return self.goodness(result)
        if result.validation is None:  # a training for a validation part failed
            return -math.inf
        return -result.validation if self.metric == "mae" else result.validation

    def goodness(self, result: ModelResult) -> float:
        r"""Returns the score on the test parts with a sign that makes it higher for better models.

        Args:
            result (ModelResult): The result of a model.
        """
        mean = result.scores[self.metric].mean
        return -mean if self.metric == "mae" else mean

    def of(self, name: str) -> ModelResult:
        r"""Returns the result of one model.

        Args:
            name (str): Name of the model.

        Raises:
            ValueError: If the model has no result.
        """
        for result in self.results:
            if result.model.name == name:
                return result
        names = [result.model.name for result in self.results]
        raise ArgumentError(Argument("name"), f" must be one of {names} (got '{name}')")

    def difference(self, first: str, second: str) -> Difference:
        r"""Returns the score of one model minus the score of another on the same splits.

        Args:
            first (str): Name of the first model.
            second (str): Name of the model whose score is subtracted.

        Raises:
            ValueError: If no split is finished for both models.
        """
        (protocol,) = self.run.plan.protocols
        difference = run_difference(
            self.run,
            first,
            second,
            protocol.name,
            self.metric,
            unit=self.units.name,
            with_units=self.units.replace_trials,
        )
        if difference is None:
            raise ValueError(f"'{first}' and '{second}' must have a finished split (got none)")
        return difference

    def validation_difference(self, first: str, second: str) -> Difference:
        r"""Returns the validation score of one model minus that of another on the same parts.

        Args:
            first (str): Name of the first model.
            second (str): Name of the model whose score is subtracted.

        Raises:
            ValueError: If a model has no validation score.
        """
        validations = [self._validations(name) for name in (first, second)]
        for name, entries in zip((first, second), validations, strict=True):
            need(entries, f"'{name}' must have a validation score (got none)")
        first_predictions, second_predictions = (
            [Predictions.from_dict(part) for entry in entries for part in entry["predictions"]]
            for entries in validations
        )
        overlap = statistics.fmean(entry["overlap"] for entry in validations[0])
        unit = self.units.name
        first_by_unit, second_by_unit = (
            [self.units.replace_trials(part) for part in predictions]
            for predictions in (first_predictions, second_predictions)
        )
        if self.units.count_units(first_by_unit) >= MIN_PAIRS:
            return paired_difference(first_by_unit, second_by_unit, self.metric, overlap, unit)
        # With too few units for a standard error, trials are the units instead.
        return paired_difference(first_predictions, second_predictions, self.metric, overlap)

    def _validations(self, name: str) -> list[dict[str, Any]]:
        validations = [r.get("validation") for e, r in self.run.results if e.name == name]
        return [entry for entry in validations if entry and entry["predictions"]]

    def predictions(self, name: str) -> list[Predictions]:
        r"""Returns the predictions of one model for each split. Their :obj:`trial` is the unit of
        each sample.

        Args:
            name (str): Name of the model.
        """
        return [
            self.units.replace_trials(Predictions.from_dict(result["predictions"]))
            for experiment, result in self.run.results
            if experiment.name == name
        ]


def comparison_plan(
    source: DataSource,
    settings: ComparisonSettings | None = None,
    *,
    name: str = "comparison",
    selection: Mapping[str, Any] | None = None,
) -> Plan:
    r"""Returns the plan of a comparison: an experiment for each model, fold and seed. Each
    experiment selects its settings within its training part and uses its test part once.

    Args:
        source (DataSource): The samples (see :func:`data_source`).
        settings (ComparisonSettings, optional): The models, splits and scores.
        name (str): Name of the comparison, for its title and messages.
        selection (Mapping, optional): Arguments of the data set that only select samples, such as
            :obj:`stride`.

    Raises:
        FileNotFoundError: If there is no data.
        ValueError: If the samples cannot be split as the settings require, or a model does not fit
            the data.
    """
    settings = settings or ComparisonSettings()
    source, tare, selection = _move_to_frames(source, settings.tare, selection)
    source, facts = source.with_arguments({}, selection).resolve()
    if facts.num_frames is not None and tare is not None:
        raise ArgumentError(
            Argument("tare"),
            " must be left out for samples of several frames: subtract the reading at rest before "
            "cutting samples",
        )
    dataset = source.load()
    if isinstance(dataset, GraphSamples) and tare is not None:
        raise ArgumentError(
            Argument("tare"),
            f" must be left out for samples from different sensors (got samples with "
            f"{dataset.describe_taxels()}): subtract the reading at rest from each sample",
        )
    is_regression = _is_regression(dataset)
    metric = settings.metric or ("mae" if is_regression else "accuracy")
    if (metric == "mae") != is_regression:
        allowed = "'mae'" if is_regression else "'accuracy' or 'balanced_accuracy'"
        kind = "numbers" if is_regression else "classes"
        raise ArgumentError(Argument("metric"), f" must be {allowed} for {kind} (got '{metric}')")
    protocol = compared_protocol(dataset, settings.by, settings.folds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about classes with few units: the runs warn as well
        num_train = mean_training_size(source, protocol)
    task = ComparedTask.from_dataset(
        dataset,
        metric,
        max(1, round(_FIT_SHARE * num_train)),
        num_frames=facts.num_frames,
        epochs=settings.epochs,
        tare=tare,
        members=settings.members,
        has_given_parts=protocol.by == "given",
    )
    models = select_models(settings.models, task)
    protocol_name = "given" if protocol.by == "given" else f"by {protocol.by}"
    table = Table(
        name=name,
        title=f"Models compared on {name}" + _describe_frames(facts.num_frames),
        data=source,
        protocols=(TableProtocol(protocol_name, protocol),),
        cells=tuple(model.to_cell(task) for model in models),
        task="regression" if is_regression else "multiclass",
        seeds=settings.seeds,
        measure_memory=False,
    )
    return list_experiments(table, table.protocols, settings.plan_settings(), source, facts)


def _move_to_frames(
    source: DataSource, tare: Mapping[str, Any] | None, selection: Mapping[str, Any] | None
) -> tuple[DataSource, dict[str, Any] | None, Mapping[str, Any] | None]:
    r"""Moves a tare and a selection from samples to the frames from which they are cut. Returns the
    source, and the tare and selection that remain for its samples: both for single frames, none for
    windows and trials.
    """
    if not source.is_view:
        return source, None if tare is None else dict(tare), selection
    source = source.with_arguments(selection or {})
    return source if tare is None else _with_tared_frames(source, tare), None, None


def _with_tared_frames(source: DataSource, tare: Mapping[str, Any]) -> DataSource:
    first_or_seconds = dict(tare)
    if first_or_seconds.pop("key", "session") != "trial":
        raise ArgumentError(
            Argument("tare"),
            f" must be of each trial, key='trial', for samples of several frames (got {tare})",
        )
    if source.frames is None:
        raise ArgumentError(
            Argument("tare"),
            " must be left out for samples of several frames, unless the source has the "
            "'dataset' that they are cut from: subtract rest readings before cutting (got "
            f"{source.class_path.rpartition('.')[2]})",
        )
    return replace(source, frames=replace(source.frames, tare=first_or_seconds), fingerprint="")


def compare(
    source: DataSource,
    settings: ComparisonSettings | None = None,
    out: PathLike = "comparison",
    jobs: int | None = None,
    *,
    name: str = "comparison",
    selection: Mapping[str, Any] | None = None,
    on_progress: OnProgress | None = None,
) -> Comparison:
    r"""Compares models on one data set (see :func:`comparison_plan`). Finished runs are stored and
    not repeated (see :func:`run_plan`).

    Args:
        source (DataSource): The samples (see :func:`data_source`).
        settings (ComparisonSettings, optional): The models, splits and scores.
        out (str or PathLike): Folder of the runs.
        jobs (int, optional): Number of parallel runs, as in :func:`run_plan`.
        name (str): Name of the comparison, for its title and messages.
        selection (Mapping, optional): Arguments of the data set that only select samples.
        on_progress (callable, optional): As in :func:`run_plan`.
    """
    plan = comparison_plan(source, settings, name=name, selection=selection)
    tolerance = None if settings is None else settings.tolerance
    return summarize(run_plan(plan, out, jobs, on_progress=on_progress), tolerance)


def summarize(run: PlanRun, tolerance: float | None = None) -> Comparison:
    r"""Returns the scores of a comparison. Models with failed or missing runs are left out.

    Args:
        run (PlanRun): The run of a comparison.
        tolerance (float, optional): As in :class:`ComparisonSettings`.

    Raises:
        ValueError: If the run is not the run of a comparison.
    """
    plan = run.plan
    choice = plan.experiments[0].choice
    if choice is None:
        raise ValueError("'run' must be the run of a comparison (got a table without choices)")
    metric = choice.metric
    by_model: dict[str, dict[tuple[int, int], dict[str, Any]]] = {}
    for experiment, result in run.results:
        by_model.setdefault(experiment.name, {})[experiment.seed, experiment.fold] = result
    splits = sorted({(e.seed, e.fold) for e in plan.experiments})
    complete = {
        name: [by_split[split] for split in splits]
        for name, by_split in by_model.items()
        if len(by_split) == len(splits)
    }
    dataset, data_splits = plan.data.load(), comparison_splits(plan)
    units = ScoreUnits.from_splits(dataset, data_splits, plan.experiments[0].protocol.by)
    constant = ConstantAnswer.from_splits(dataset, data_splits, metric)
    if tolerance is None:
        tolerance = _TOLERANCES.get(metric, _TOLERANCE)
    comparison = Comparison(run, metric, (), None, units, constant, tolerance)
    results = tuple(
        ModelResult(
            model=_find_measured_model(name, complete[name]),
            scores={key: _summarize_metric(complete[name], key) for key in comparison.metrics},
            difference=None,
            num_parameters=_mean_or_none([r["num_parameters"] for r in complete[name]]),
            seconds=statistics.fmean(
                r["choose_seconds"] + r["train_seconds"] for r in complete[name]
            ),
            milliseconds=1000
            * statistics.fmean(r["predict_seconds"] / r["num_test"] for r in complete[name]),
            chosen=tuple(r["chosen"] for r in complete[name]),
            validation=_validation_score(complete[name]),
        )
        for name in (cell.experiment for cell in plan.table.cells)
        if name in complete
    )
    comparison = replace(comparison, results=results)
    merits = {result.model.name: comparison.merit(result) for result in results}
    if metric == "mae":
        smallest = min((-merit for merit in merits.values()), default=0.0)
        comparison = replace(comparison, tolerance=tolerance * smallest)
    plain = [result.model.name for result in results if not result.model.is_graph]
    best_plain = max(plain, key=lambda name: (merits[name], name != FLOOR), default=None)
    if best_plain is None:
        return comparison
    return replace(
        comparison,
        best_plain=best_plain,
        results=tuple(
            result
            if result.model.name == best_plain
            else replace(result, difference=comparison.difference(result.model.name, best_plain))
            for result in results
        ),
    )


def _validation_score(results: list[dict[str, Any]]) -> float | None:
    # Returns the mean over the seeds, or None for folds or if a training run failed.
    scores = [(result.get("validation") or {}).get("score") for result in results]
    return _mean_or_none(scores)


def _find_measured_model(name: str, results: list[dict[str, Any]]) -> ComparedModel:
    # Only the runs show whether a user's network reads edges.
    model = find_model(name)
    return replace(model, is_graph=True) if results[0].get("is_graph") else model


def _describe_frames(num_frames: int | None) -> str:
    return "" if num_frames is None else f", {num_frames} frames per sample"


def _summarize_metric(results: list[dict[str, Any]], metric: str) -> Summary:
    values = [result["metrics"][metric] for result in results]
    if None in values:  # R2 of one sample
        return Summary(math.nan, math.nan)
    return Summary(
        statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan
    )


def _mean_or_none(values: list[Any]) -> float | None:
    return None if None in values else statistics.fmean(values)


def _is_regression(dataset: SampleSet) -> bool:
    y = dataset.column("y")
    if y is None:
        raise ArgumentError(
            Argument("data"), " must have 'y', a class or numbers for each sample (got none)"
        )
    if y.dim() == 1 and not y.is_floating_point():
        need(
            not len(y) or int(y.min()) >= 0,
            "'y' must be classes from 0; leave out samples without a class with "
            "dataset[dataset.y >= 0]",
            int(y.min()) if len(y) else 0,
        )
        return False
    if y.dim() > 1 and bool(((y == 0) | (y == 1)).all()):
        raise ValueError(
            f"'y' must be one class per sample, or numbers (got 0 and 1 for each of {y.shape[1]} "
            "labels): select one label, or another target"
        )
    return True
