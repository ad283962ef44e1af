r"""Judging models on protocols that say what they hold out."""

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

import lightning as L
import numpy as np
import torch
from joblib import Parallel, delayed
from sklearn.dummy import DummyClassifier
from sklearn.metrics import accuracy_score, f1_score
from tqdm import tqdm

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.data import StaticDataset, splits
from torch_geometric_tactile.parallel import kept_memory
from torch_geometric_tactile.training.config import load_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileClassifier, classifier_from_config
from torch_geometric_tactile.transforms import FittedTransform, SessionZScore, ZScore

Protocol = Literal["random folds", "leave objects out", "unseen objects"]
Scaling = Literal["raw", "session"]
PROTOCOLS: tuple[Protocol, ...] = ("random folds", "leave objects out", "unseen objects")
SCALINGS: tuple[Scaling, ...] = ("raw", "session")

# The networks are the shipped configurations of these names.
MODELS = {
    "GCN-DF": "grasp_gcn_df",
    "GCN-FF": "grasp_gcn_ff",
    "GCN index": "grasp_gcn_index",
    "GCN middle": "grasp_gcn_middle",
    "GCN thumb": "grasp_gcn_thumb",
    "SVM": None,
    "Majority": None,
}


class Job(NamedTuple):
    r"""One model to train: :obj:`fold` of the folds drawn by :obj:`seed`, which also seeds the
    training.
    """

    model: str
    protocol: Protocol
    scaling: Scaling
    seed: int
    fold: int


class Judgement(NamedTuple):
    r"""What a model said of the samples held out: :obj:`score` is higher where it expects class 1,
    :obj:`prediction` is the class :math:`(S,)`; :obj:`y` and :obj:`session` are those of the
    samples.
    """

    score: np.ndarray
    prediction: np.ndarray
    y: np.ndarray
    session: np.ndarray

    def select(self, mask: np.ndarray) -> "Judgement":
        r"""Returns the judgement of some of the samples.

        Args:
            mask (numpy.ndarray): Which ones :math:`(S,)`.
        """
        return Judgement(*(value[mask] for value in self))

    def metrics(self) -> dict[str, float]:
        r"""Returns accuracy, the F1 score of class 1, and the mean F1 score of both classes."""
        return {
            "accuracy": float(accuracy_score(self.y, self.prediction)),
            "f1": float(f1_score(self.y, self.prediction, pos_label=1, zero_division=0.0)),
            "f1_macro": float(
                f1_score(self.y, self.prediction, average="macro", zero_division=0.0)
            ),
        }


def scaling_transform(scaling: Scaling) -> FittedTransform:
    r"""Returns the transform of a scaling: :obj:`"raw"` scales by the training part only, which
    takes no session offset out; :obj:`"session"` scales session by session without labels.

    Args:
        scaling (str): Name of the scaling.
    """
    return SessionZScore() if scaling == "session" else ZScore()


def make_jobs(
    models: Sequence[str], seeds: int, folds: int, scalings: Sequence[Scaling] = SCALINGS
) -> list[Job]:
    r"""Lists what is to be trained, the longest jobs first.

    Args:
        models (list of str): Names in :obj:`MODELS`.
        seeds (int): Number of seeds.
        folds (int): Number of folds of the two protocols with folds.
        scalings (list of str): The scalings.
    """
    jobs = [
        Job(model, protocol, scaling, seed, fold)
        for model in models
        for protocol in PROTOCOLS
        for scaling in scalings
        for seed in range(seeds)
        for fold in range(1 if protocol == "unseen objects" else folds)
    ]
    cost = {"GCN-FF": 0, "GCN-DF": 1}
    return sorted(jobs, key=lambda job: cost.get(job.model, 2))


def run_jobs(
    jobs: Sequence[Job],
    train: StaticDataset,
    test: StaticDataset,
    folds: int,
    epochs: int | None = None,
    num_processes: int = 1,
    progress: bool = True,
) -> dict[Job, Judgement]:
    r"""Trains and judges models, several at a time. The result depends on the jobs only, not on the
    number of processes or their order.

    Args:
        jobs (list of Job): What to train.
        train (StaticDataset): Training objects, also for the folds.
        test (StaticDataset): Unseen objects.
        folds (int): Number of folds.
        epochs (int, optional): Epochs of the networks, instead of those of their configurations.
        num_processes (int): How many processes.
        progress (bool): Whether to show a progress bar.
    """
    call = delayed(run_job)
    parallel = Parallel(n_jobs=num_processes, return_as="generator_unordered")
    with kept_memory():
        results = parallel(call(job, train, test, folds, epochs) for job in jobs)
        bar = tqdm(
            results, total=len(jobs), desc="Train and judge", unit="model", disable=not progress
        )
        done = dict(bar)
    return {job: done[job] for job in jobs}


def run_job(
    job: Job, train: StaticDataset, test: StaticDataset, folds: int, epochs: int | None = None
) -> tuple[Job, Judgement]:
    r"""Trains one model and judges it on what it has not seen.

    Args:
        job (Job): What to train.
        train (StaticDataset): Training objects.
        test (StaticDataset): Unseen objects.
        folds (int): Number of folds.
        epochs (int, optional): Epochs of a network, instead of those of its configuration.
    """
    if job.protocol != "unseen objects":
        by: splits.Unit = "frame" if job.protocol == "random folds" else "group"
        fold = splits.k_fold(train, folds, by, job.seed)[job.fold]
        train, test = train[fold.train], train[fold.test]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # small products; the processes share the cores
    try:
        if MODELS[job.model] is None:
            return job, _judge_estimator(job, train, test)
        config = load_config(str(MODELS[job.model]))
        data = data_module(config, train, test, job.scaling)
        classifier = train_classifier(config, data, job.seed, epochs)
        return job, judge(classifier, data)
    finally:
        torch.set_num_threads(threads)


def data_module(
    config: dict[str, Any], train: StaticDataset, test: StaticDataset, scaling: Scaling
) -> TactileDataModule:
    r"""Returns a data module that trains on all of one data set and tests on all of another.

    Args:
        config (dict): A shipped configuration.
        train (StaticDataset): The training part.
        test (StaticDataset): What is held out.
        scaling (str): Name of the scaling.
    """
    return TactileDataModule(
        train,
        test,
        split="frame",
        val=0.0,
        transform=scaling_transform(scaling),
        batch_size=config["data"]["batch_size"],
    )


def train_classifier(
    config: dict[str, Any],
    data: TactileDataModule,
    seed: int,
    epochs: int | None = None,
    **trainer_arguments: Any,
) -> TactileClassifier:
    r"""Trains the classifier of a configuration.

    Args:
        config (dict): A shipped configuration.
        data (TactileDataModule): What to train on.
        seed (int): Seed of weights and batches.
        epochs (int, optional): Number of epochs, instead of the configuration's.
        **trainer_arguments: Of :class:`lightning.Trainer`; without any, nothing is shown or kept.
    """
    L.seed_everything(seed, verbose=False)
    classifier = classifier_from_config(config["model"], data)
    with quiet():
        trainer = L.Trainer(
            accelerator="cpu",
            devices=1,
            max_epochs=epochs or config["trainer"]["max_epochs"],
            **(trainer_arguments or {"barebones": True}),
        )
        trainer.fit(classifier, datamodule=data)
    return classifier


def judge(classifier: TactileClassifier, data: TactileDataModule) -> Judgement:
    r"""Judges a classifier on the test part of a data module.

    Args:
        classifier (TactileClassifier): The classifier.
        data (TactileDataModule): The data, set up.
    """
    classifier.eval()
    batches = list(data.test_dataloader())
    with torch.inference_mode():
        probability = torch.cat([classifier(batch).softmax(dim=-1) for batch in batches])
    return Judgement(
        score=probability[:, 1].numpy(),
        prediction=probability.argmax(dim=-1).numpy(),
        y=torch.cat([batch.y for batch in batches]).numpy(),
        session=torch.cat([batch.session for batch in batches]).numpy(),
    )


def _judge_estimator(job: Job, train: StaticDataset, test: StaticDataset) -> Judgement:
    transform = scaling_transform(job.scaling)
    transform.fit(train).adapt(test)
    seen, held_out = transform(train.data), transform(test.data)
    x, y = seen.x.numpy(), seen.y.numpy()
    if job.model == "SVM":
        svm = GraspSVM(num_fingers=x.shape[-1]).fit(x, y)
        score = svm.decision_function(held_out.x.numpy())
        prediction = svm.predict(held_out.x.numpy())
    else:
        majority = DummyClassifier(strategy="most_frequent").fit(x[:, 0], y)
        prediction = majority.predict(held_out.x.numpy()[:, 0])
        score = prediction.astype(float)
    return Judgement(score, prediction, held_out.y.numpy(), held_out.session.numpy())


def pool_folds(results: dict[Job, Judgement]) -> dict[Job, Judgement]:
    r"""Joins the folds of each seed, so that every sample is judged once.

    Args:
        results (dict): Of :func:`run_jobs`; the folds come back under fold 0.
    """
    parts: dict[Job, list[Judgement]] = {}
    for job, judgement in results.items():
        parts.setdefault(job._replace(fold=0), []).append(judgement)
    return {
        job: Judgement(*(np.concatenate(values) for values in zip(*part, strict=True)))
        for job, part in parts.items()
    }


def summarize(
    pooled: dict[Job, Judgement], session_names: Sequence[str]
) -> Iterator[dict[str, Any]]:
    r"""Yields a record for each model, protocol, scaling and seed, and for each session of the
    unseen objects.

    Args:
        pooled (dict): Of :func:`pool_folds`.
        session_names (list of str): Names of the sessions.
    """
    for job, judgement in pooled.items():
        parts = {str(job.protocol): judgement}
        if job.protocol == "unseen objects":
            for session in np.unique(judgement.session):
                name = session_names[session].removesuffix("_test").replace("_", " ")
                parts[name] = judgement.select(judgement.session == session)
        for name, part in parts.items():
            yield {
                "model": job.model,
                "protocol": name,
                "scaling": job.scaling,
                "seed": job.seed,
                "num_samples": len(part.y),
                **part.metrics(),
            }


@contextmanager
def quiet() -> Iterator[None]:
    r"""Keeps Lightning from explaining itself at every start: hundreds of trainings would drown."""
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(level)
