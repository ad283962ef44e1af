r"""Models compared on one data set: the plan and the scores."""

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
    chosen_models,
    model_of,
)
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._held_out import compared_protocol, mean_training_size
from torch_geometric_tactile.experiments._score_units import (
    ConstantAnswer,
    ScoreUnits,
    comparison_splits,
)
from torch_geometric_tactile.experiments._scores import LEAST_PAIRS
from torch_geometric_tactile.experiments.compared_windows import apply_to_frames
from torch_geometric_tactile.experiments.differences import (
    Difference,
    paired_difference,
    run_difference,
)
from torch_geometric_tactile.experiments.plan import Plan, Settings, list_experiments
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import OnProgress, PlanRun, run_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.tables import Table, TableProtocol

_CLASS_METRICS = ("accuracy", "balanced_accuracy", "f1")
_NUMBER_METRICS = ("mae", "rmse", "r2")
_UNITS = ("trial", "group", "session", "frame", "given")
# The part of the training samples on which settings are chosen: the recipe of networks follows it.
_CHOOSE_ON = 0.8
_TOLERANCE = 0.01  # one point
_TOLERANCES = {"mae": 0.02}  # of the smallest error


@dataclass(frozen=True)
class ComparisonSettings:
    r"""What is compared, and how.

    Args:
        models (tuple of str, optional): Names of the models, or import paths of your own (a class
            of a network, or what returns an estimator of scikit-learn); all of ours that have a
            place in the data if left out.
        by (str, optional): What stays together in a split: :obj:`"trial"`, :obj:`"group"`,
            :obj:`"session"`, :obj:`"frame"` (nothing), or :obj:`"given"`. If left out, the trial;
            without trials the group, where three or more of them share their classes; otherwise the
            frame. Without trials a warning says which.
        folds (int): Number of folds: each is tested on once a seed.
        seeds (int): How often the folds are drawn, or models are trained on given parts.
        metric (str, optional): What models are chosen by and compared by: :obj:`"accuracy"` (of
            classes, if left out), :obj:`"balanced_accuracy"` (then rare classes also weigh as much
            in training), or :obj:`"mae"` (of numbers).
        epochs (int, optional): Epochs of a network; by the number of samples if left out.
        members (int, optional): How many networks of a kind are trained on each training part; what
            they say is averaged. If left out, three, or one with more than 1,000 training samples.
        tare (dict, optional): Arguments of :class:`~torch_geometric_tactile.transforms.Tare`, such
            as :obj:`{"key": "trial", "first": 10}`, where each trial begins at rest. Of windows,
            the frames are tared before these are cut.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of each run.
        tolerance (float, optional): How much worse than the best a simpler model may be to be
            recommended in its place: a part of one (0.01, one point, if left out), or for
            :obj:`"mae"` a part of the smallest error (0.02 if left out).

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
        need_argument(
            self.by in (None, *_UNITS), "by", f"must be one of {list(_UNITS)} (got '{self.by}')"
        )
        if self.metric not in (None, "accuracy", "balanced_accuracy", "mae"):
            raise ArgumentError(
                Argument("metric"),
                f" must be 'accuracy', 'balanced_accuracy' or 'mae' (got '{self.metric}')",
            )
        need_argument(
            self.members is None or self.members >= 1, "members", "must be at least 1", self.members
        )
        self.of_plan()

    def of_plan(self) -> Settings:
        r"""Returns those that every plan has."""
        return Settings(
            seeds=self.seeds,
            epochs=self.epochs,
            folds=self.folds,
            accelerator=self.accelerator,
            threads=self.threads,
        )


class Summary(NamedTuple):
    r"""Mean and standard deviation over splits, or over the seeds of given parts; the latter is NaN
    for less than two.
    """

    mean: float
    sd: float


@dataclass(frozen=True)
class ModelResult:
    r"""Scores of one model over all splits, or over all seeds of given parts.

    Args:
        model (ComparedModel): The model.
        scores (dict): Mean and standard deviation of each score, by its name.
        difference (Difference, optional): To the best plain model; :obj:`None` for itself.
        num_parameters (float, optional): Weights, or numbers that an estimator holds, mean.
        seconds (float): Of choosing and training on one split, mean.
        milliseconds (float): Of predicting one sample, mean.
        chosen (tuple of dict): What was chosen on each split.
        validation (float, optional): Of given parts, the score that is compared, on validation
            parts: the mean over these and over the seeds.
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
    r"""Scores of all models of a comparison. :obj:`results` are in the order of the models.

    Args:
        run (PlanRun): The runs.
        metric (str): What is compared.
        results (tuple of ModelResult): Of the models that have a result for every split.
        best_plain (str, optional): The best of the plain models by :meth:`merit`, by its name.
        units (ScoreUnits): What is new in the test parts, and counts as one observation.
        constant (ConstantAnswer): The most frequent answer, or the mean, and its score.
        tolerance (float): How much worse than the best a simpler model may be to be recommended:
            a score, or for :obj:`"mae"` an error.
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
        r"""Whether all models are tested on one test part that was given."""
        return all(e.protocol.by == "given" for e in self.run.plan.experiments)

    @property
    def num_splits(self) -> int:
        r"""The number of splits that each model is compared on. Given parts are one split, with any
        number of seeds.
        """
        splits = {(e.seed, e.fold) for e in self.run.plan.experiments}
        return 1 if self.has_given_parts else len(splits)

    @property
    def num_seeds(self) -> int:
        r"""How often each model was trained on each training part, or the folds were drawn."""
        return len({e.seed for e in self.run.plan.experiments})

    @property
    def is_validated(self) -> bool:
        r"""Whether a model is chosen by validation scores, as with given parts, and not by the
        scores of the test parts.
        """
        return any(result.validation is not None for result in self.results)

    @property
    def best(self) -> ModelResult | None:
        r"""The model with the most merit; of equals the smallest."""

        def rank(result: ModelResult) -> tuple[float, float, float]:
            size = math.inf if result.num_parameters is None else result.num_parameters
            return -round(self.merit(result), 12), size, result.milliseconds

        return min(self.results, key=rank, default=None)

    def merit(self, result: ModelResult) -> float:
        r"""Returns what models are chosen by, higher for better ones: the validation score if
        :obj:`is_validated`, and otherwise :meth:`goodness`.

        Args:
            result (ModelResult): Of a model.
        """
        if not self.is_validated:
            return self.goodness(result)
        if result.validation is None:  # its training failed without the validation parts
            return -math.inf
        return -result.validation if self.metric == "mae" else result.validation

    def goodness(self, result: ModelResult) -> float:
        r"""Returns the score on the test parts that is compared, higher for better ones.

        Args:
            result (ModelResult): Of a model.
        """
        mean = result.scores[self.metric].mean
        return -mean if self.metric == "mae" else mean

    def of(self, name: str) -> ModelResult:
        r"""Returns the scores of one model.

        Args:
            name (str): Its name.

        Raises:
            ValueError: If nothing did.
        """
        for result in self.results:
            if result.model.name == name:
                return result
        known = [result.model.name for result in self.results]
        raise ArgumentError(Argument("name"), f" must be one of {known} (got '{name}')")

    def difference(self, first: str, second: str) -> Difference:
        r"""Returns the score of one model less that of another on the same splits.

        Args:
            first (str): Name of the one.
            second (str): Name of the other.
        """
        (protocol,) = self.run.plan.protocols
        difference = run_difference(
            self.run,
            first,
            second,
            protocol.name,
            self.metric,
            unit=self.units.name,
            with_units=self.units.of_predictions,
        )
        if difference is None:
            raise ValueError(f"'{first}' and '{second}' must have a finished split (got none)")
        return difference

    def validation_difference(self, first: str, second: str) -> Difference:
        r"""Returns the validation score of one model less that of another on the same parts.

        Args:
            first (str): Name of the one.
            second (str): Name of the other.

        Raises:
            ValueError: If one of them has no validation score.
        """
        validations = [self._validations(name) for name in (first, second)]
        for name, of_model in zip((first, second), validations, strict=True):
            need(of_model, f"'{name}' must have a validation score (got none)")
        one, other = (
            [Predictions.from_dict(said) for entry in of_model for said in entry["predictions"]]
            for of_model in validations
        )
        overlap = statistics.fmean(entry["overlap"] for entry in validations[0])
        unit = self.units.name
        one_by_unit, other_by_unit = (
            [self.units.of_predictions(said) for said in part] for part in (one, other)
        )
        if self.units.num_of(one_by_unit) >= LEAST_PAIRS:
            return paired_difference(one_by_unit, other_by_unit, self.metric, overlap, unit)
        return paired_difference(one, other, self.metric, overlap)  # fewer than can be counted

    def _validations(self, name: str) -> list[dict[str, Any]]:
        validations = [r.get("validation") for e, r in self.run.results if e.name == name]
        return [entry for entry in validations if entry and entry["predictions"]]

    def predictions(self, name: str) -> list[Predictions]:
        r"""Returns the predictions of one model, split by split, with their units as trials.

        Args:
            name (str): Name of the model.
        """
        return [
            self.units.of_predictions(Predictions.from_dict(result["predictions"]))
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
    r"""Lists the experiments of a comparison: models by folds by seeds, each of which chooses its
    settings on a part of its training samples and looks at its test samples once.

    Args:
        source (DataSource): The samples (see :func:`data_source`).
        settings (ComparisonSettings, optional): What is compared, and how.
        name (str): Name of its files.
        selection (Mapping, optional): Arguments of the data set that only choose among the samples,
            such as :obj:`stride`.

    Raises:
        FileNotFoundError: If there is no data.
        ValueError: If the samples cannot be split so, or a model has no place in the data.
    """
    settings = settings or ComparisonSettings()
    source, tare, selection = apply_to_frames(source, settings.tare, selection)
    source, facts = source.with_arguments({}, selection).resolve()
    if facts.num_frames is not None and tare is not None:
        raise ArgumentError(
            Argument("tare"),
            " must be left out for samples of several frames: subtract rest readings before "
            "they are cut",
        )
    dataset = source.load()
    if isinstance(dataset, GraphSamples) and tare is not None:
        raise ArgumentError(
            Argument("tare"),
            f" must be left out for samples of different sensors (got samples of "
            f"{dataset.describe_taxels()}): subtract rest readings sample by sample",
        )
    numbers = _predicts_numbers(dataset)
    metric = settings.metric or ("mae" if numbers else "accuracy")
    if (metric == "mae") != numbers:
        allowed = "'mae'" if numbers else "'accuracy' or 'balanced_accuracy'"
        kind = "numbers" if numbers else "classes"
        raise ArgumentError(Argument("metric"), f" must be {allowed} for {kind} (got '{metric}')")
    protocol = compared_protocol(dataset, settings.by, settings.folds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of classes with few units, which the runs tell of
        num_train = mean_training_size(source, protocol)
    task = ComparedTask.of(
        dataset,
        metric,
        max(1, round(_CHOOSE_ON * num_train)),
        num_frames=facts.num_frames,
        epochs=settings.epochs,
        tare=tare,
        members=settings.members,
        has_given_parts=protocol.by == "given",
    )
    models = chosen_models(settings.models, task)
    held_out = "given" if protocol.by == "given" else f"by {protocol.by}"
    table = Table(
        name=name,
        title=f"Models compared on {name}" + _frames_in_words(facts.num_frames),
        data=source,
        protocols=(TableProtocol(held_out, protocol),),
        cells=tuple(model.to_cell(task) for model in models),
        task="regression" if numbers else "multiclass",
        seeds=settings.seeds,
        measure_memory=False,
    )
    return list_experiments(table, table.protocols, settings.of_plan(), source, facts)


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
    r"""Compares models on one data set: see :func:`comparison_plan` and :func:`run_plan`, which
    keeps finished runs.

    Args:
        source (DataSource): The samples (see :func:`data_source`).
        settings (ComparisonSettings, optional): What is compared, and how.
        out (str or PathLike): Folder of the runs.
        jobs (int, optional): Number of runs at a time, as of :func:`run_plan`.
        name (str): Name of its files.
        selection (Mapping, optional): Arguments of the data set that only choose among the samples.
        on_progress (callable, optional): Called with each run that ended.
    """
    plan = comparison_plan(source, settings, name=name, selection=selection)
    tolerance = None if settings is None else settings.tolerance
    return summarize(run_plan(plan, out, jobs, on_progress=on_progress), tolerance)


def summarize(run: PlanRun, tolerance: float | None = None) -> Comparison:
    r"""Returns the scores of a comparison. Models with failed or missing runs are left out.

    Args:
        run (PlanRun): What :func:`run_plan` returned.
        tolerance (float, optional): As of :class:`ComparisonSettings`.
    """
    plan = run.plan
    choice = plan.experiments[0].choice
    if choice is None:
        raise ValueError("'run' must be of a comparison (got a table without choices)")
    metric = choice.metric
    by_model: dict[str, dict[tuple[int, int], dict[str, Any]]] = {}
    for experiment, result in run.results:
        by_model.setdefault(experiment.name, {})[experiment.seed, experiment.fold] = result
    splits = sorted({(e.seed, e.fold) for e in plan.experiments})
    whole = {
        name: [of_split[split] for split in splits]
        for name, of_split in by_model.items()
        if len(of_split) == len(splits)
    }
    dataset, data_splits = plan.data.load(), comparison_splits(plan)
    units = ScoreUnits.of(dataset, data_splits)
    constant = ConstantAnswer.of(dataset, data_splits, metric)
    if tolerance is None:
        tolerance = _TOLERANCES.get(metric, _TOLERANCE)
    comparison = Comparison(run, metric, (), None, units, constant, tolerance)
    results = tuple(
        ModelResult(
            model=_measured_model(name, whole[name]),
            scores={key: _summary(whole[name], key) for key in comparison.metrics},
            difference=None,
            num_parameters=_mean([r["num_parameters"] for r in whole[name]]),
            seconds=statistics.fmean(r["choose_seconds"] + r["train_seconds"] for r in whole[name]),
            milliseconds=1000
            * statistics.fmean(r["predict_seconds"] / r["num_test"] for r in whole[name]),
            chosen=tuple(r["chosen"] for r in whole[name]),
            validation=_validation_score(whole[name]),
        )
        for name in (cell.experiment for cell in plan.table.cells)
        if name in whole
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
    # Over the seeds; none of folds, nor of a model whose training failed on a part.
    scores = [(result.get("validation") or {}).get("score") for result in results]
    return _mean(scores)


def _measured_model(name: str, results: list[dict[str, Any]]) -> ComparedModel:
    # Only once it is built, a network of one's own tells whether it passes messages.
    model = model_of(name)
    return replace(model, is_graph=True) if results[0].get("is_graph") else model


def _frames_in_words(num_frames: int | None) -> str:
    return "" if num_frames is None else f", {num_frames} frames a sample"


def _summary(results: list[dict[str, Any]], metric: str) -> Summary:
    values = [result["metrics"][metric] for result in results]
    if None in values:  # R2 of one sample
        return Summary(math.nan, math.nan)
    return Summary(
        statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan
    )


def _mean(values: list[Any]) -> float | None:
    return None if None in values else statistics.fmean(values)


def _predicts_numbers(dataset: SampleSet) -> bool:
    y = dataset.column("y")
    if y is None:
        raise ArgumentError(
            Argument("data"), " must have 'y', a class or numbers for each sample (got none)"
        )
    if y.dim() == 1 and not y.is_floating_point():
        need(
            not len(y) or int(y.min()) >= 0,
            "'y' must be classes from 0; leave out samples without a class, with "
            "dataset[dataset.y >= 0]",
            int(y.min()) if len(y) else 0,
        )
        return False
    if y.dim() > 1 and bool(((y == 0) | (y == 1)).all()):
        raise ValueError(
            f"'y' must be one class a sample, or numbers (got 0 and 1 for each of {y.shape[1]} "
            "labels): choose one of them, or another target"
        )
    return True
