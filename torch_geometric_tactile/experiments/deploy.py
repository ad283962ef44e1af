r"""Trains the recommended model of a comparison as a predictor."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import torch
from sklearn.pipeline import Pipeline
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.baselines import TemperatureScaling
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.data._shared_samples import sharing_ignored
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._compared_task import NO_PREDICTOR
from torch_geometric_tactile.experiments._estimators import (
    estimator_input,
    fitted_samples,
    seeded_estimator,
)
from torch_geometric_tactile.experiments._experiment import Choice, Experiment
from torch_geometric_tactile.experiments._held_out import column_of
from torch_geometric_tactile.experiments._networks import (
    Clock,
    TargetScale,
    fit_classifier,
    layout_edges,
    member_seed,
    prepare_part,
)
from torch_geometric_tactile.experiments.advice import advice, recommended
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult
from torch_geometric_tactile.predictor import (
    AverageModel,
    MeasuredScore,
    Predictor,
    estimator_predictor,
)
from torch_geometric_tactile.predictor._preparation import add_shared_attributes
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.one_cycle import OneCycle


def deploy(comparison: Comparison, name: str | None = None) -> Predictor:
    r"""Trains a model of a comparison again and returns it as a predictor. The predictor contains
    the transforms of the comparison, the class names, the preparation of recordings, and the
    measured score.

    The model is trained on all samples with the setting that was selected on most splits (or the
    default setting, if there is a tie). If the parts are given (:obj:`by="given"`), it is trained
    on the training and validation parts, and the test part stays unused. As in the comparison, a
    network is the average of :obj:`members` networks.

    Estimators without probabilities are calibrated by
    :class:`~torch_geometric_tactile.baselines.TemperatureScaling` on held-out trials, or held-out
    units of the comparison.

    Args:
        comparison (Comparison): The scores.
        name (str, optional): Name of the model. Defaults to the recommended model.

    Raises:
        ValueError: If no model is recommended, there is no result of :obj:`name`, or the source
            code of a user's model was edited after the comparison.

    Examples:
        >>> deploy(compare(data_source("touches.npz", grid="28x50"))).save("best.predictor")
        ... # doctest: +SKIP
    """
    result = recommended(comparison) if name is None else comparison.of(name)
    if result is None:
        raise ValueError(f"'name' must be the name of a model (got none). {advice(comparison)}")
    experiment = next(e for e in comparison.run.plan.experiments if e.name == result.model.name)
    choice = experiment.choice
    assert choice is not None
    need(
        experiment.read_sources().modules == experiment.sources.modules,
        f"the source code of '{result.model.name}' was edited after the comparison; compare again",
    )
    experiment = experiment.with_setting(_most_frequent_setting(result, choice))
    samples, trained_on = _training_samples(experiment)
    if isinstance(samples, GraphSamples):
        raise ValueError(NO_PREDICTOR)
    threads = torch.get_num_threads()
    torch.set_num_threads(experiment.threads)
    try:
        train = _train_estimator if experiment.is_estimator else _train_networks
        predictor = train(experiment, choice, samples)
    finally:
        torch.set_num_threads(threads)
    mean, sd = result.scores[comparison.metric]
    predictor.score = MeasuredScore(
        model=result.model.name,
        metric=comparison.metric,
        mean=mean,
        # The standard deviation of the score is over splits, not over seeds.
        sd=sd if math.isfinite(sd) and not comparison.has_given_parts else None,
        num_splits=comparison.num_splits,
        protocol=experiment.protocol.describe(),
        trained_on=trained_on,
    )
    return predictor


def _most_frequent_setting(result: ModelResult, choice: Choice) -> Mapping[str, Any]:
    count = Counter(selection["number"] for selection in result.chosen)
    number = max(count, key=lambda number: (count[number], -number))  # 0 is the default
    return choice.settings[number]


def _training_samples(experiment: Experiment) -> tuple[SampleSet, str]:
    # Returns the samples to train on, and their description.
    samples = experiment.data.samples()
    if experiment.protocol.by != "given":
        return samples, f"all {len(samples):,} samples"
    with sharing_ignored():
        split = experiment.protocol.split(samples)
    indices = torch.cat([split.train, split.val]).sort().values
    return samples[indices], f"the {len(indices):,} samples of the training and validation parts"


def _train_estimator(experiment: Experiment, choice: Choice, samples: StaticDataset) -> Predictor:
    transform = build_object(experiment.transform)
    train_samples = fitted_samples(transform, samples)
    pipeline = seeded_estimator(experiment.model, samples.layout, experiment.seed)
    fit_arguments: dict[str, Any] = {}
    if not choice.is_regression and not hasattr(pipeline, "predict_proba"):
        *first, (name, last) = pipeline.steps
        pipeline = Pipeline([*first, (name, TemperatureScaling(last))])
        by = experiment.protocol.by
        unit = "trial" if by in ("frame", "given") else by
        fit_arguments[f"{name}__groups"] = column_of(samples, unit)
    pipeline.fit(estimator_input(pipeline, train_samples), train_samples.y.numpy(), **fit_arguments)
    return estimator_predictor(pipeline, samples, transform)


def _train_networks(experiment: Experiment, choice: Choice, samples: StaticDataset) -> Predictor:
    section, scale = dict(experiment.model), None
    if choice.is_regression:
        scale = TargetScale.from_samples(samples)
    else:
        section.setdefault("num_classes", samples.num_classes)
    train = prepare_part(samples, scale)
    data = TactileDataModule(
        train,
        train[:0],
        split="frame",
        val_dataset=train[:0],
        transform=build_object(experiment.transform),
        train_transform=build_object(experiment.train_transform, samples.layout),
        batch_size=experiment.batch_size,
    )
    data.setup()
    settings = {"accelerator": experiment.accelerator, "limit_val_batches": 0}
    models: list[Module] = []
    for member in range(choice.members):
        seed = member_seed(experiment.seed, member)
        options = {**settings, **experiment.trainer}
        classifier = fit_classifier(
            section, data, seed, options, experiment.epochs, Clock(), OneCycle()
        )
        models.append(classifier.model.eval().cpu())
    if scale is not None:
        network: Module = AverageModel(models, numbers=True, center=scale.center, scale=scale.scale)
    else:
        network = models[0] if len(models) == 1 else AverageModel(models)
    predictor = Predictor.from_dataset(
        network, samples, data.transform, "multiclass" if scale is None else "regression"
    )
    shared = {"edge_index": layout_edges(samples.layout), "pos": samples.layout.pos}
    return Predictor._from_parts(
        add_shared_attributes(predictor.preparation, **shared), predictor.network
    )
