import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.experiments.evaluation import (
    MODELS,
    Job,
    Judgement,
    make_jobs,
    pool_folds,
    run_job,
    run_jobs,
    summarize,
)
from torch_geometric_tactile.transforms import KNNGraph

TRAIN = FakeTactileDataset(120, pre_transform=KNNGraph(2))
TEST = FakeTactileDataset(60, "test", pre_transform=KNNGraph(2))


def test_metrics_by_hand():
    judged = Judgement(
        score=np.array([0.9, 0.8, 0.2, 0.1]),
        prediction=np.array([1, 1, 0, 0]),
        y=np.array([1, 0, 0, 0]),
        session=np.zeros(4, dtype=int),
    )
    metrics = judged.metrics()
    assert metrics["accuracy"] == 0.75
    assert metrics["f1"] == pytest.approx(2 / 3)
    assert metrics["f1_macro"] == pytest.approx((2 / 3 + 4 / 5) / 2)


def test_jobs_are_all_combinations():
    jobs = make_jobs(list(MODELS), seeds=2, folds=3)
    assert len(jobs) == len(set(jobs)) == len(MODELS) * 2 * 2 * (3 + 3 + 1)
    assert jobs[0].model == "GCN-FF"


@pytest.mark.parametrize("model", list(MODELS))
def test_every_model_is_judged_on_unseen_objects(model):
    _, judged = run_job(Job(model, "unseen objects", "session", 0, 0), TRAIN, TEST, 2, epochs=1)
    assert np.array_equal(judged.y, TEST.data.y.numpy())
    assert set(judged.session) == {3, 4, 5}


def test_majority_says_one_class_only():
    _, judged = run_job(Job("Majority", "unseen objects", "raw", 0, 0), TRAIN, TEST, 2)
    majority = int(TRAIN.data.y.float().mean() > 0.5)
    assert set(judged.prediction) == {majority}


def test_result_depends_on_the_job_only():
    jobs = [
        Job("GCN-DF", "leave objects out", "session", seed, fold)
        for seed, fold in ((0, 0), (1, 1), (0, 1))
    ]
    one = run_jobs(jobs, TRAIN, TEST, folds=2, epochs=1, num_processes=1, progress=False)
    two = run_jobs(jobs[::-1], TRAIN, TEST, folds=2, epochs=1, num_processes=2, progress=False)
    for job in jobs:
        assert np.array_equal(one[job].score, two[job].score)
    assert not np.array_equal(one[jobs[0]].score, one[jobs[2]].score)


def test_folds_judge_every_sample_once():
    jobs = [Job("Majority", "random folds", "raw", 0, fold) for fold in range(3)]
    results = run_jobs(jobs, TRAIN, TEST, folds=3, progress=False)
    pooled = pool_folds(results)
    assert list(pooled) == [jobs[0]]
    judged = pooled[jobs[0]]
    assert len(judged.y) == len(TRAIN)
    assert judged.y.sum() == TRAIN.data.y.sum()


def test_left_out_objects_are_not_in_training(monkeypatch):
    seen = {}

    def record(job, train, test):
        seen["groups"] = (set(train.data.group.tolist()), set(test.data.group.tolist()))

    monkeypatch.setattr("torch_geometric_tactile.experiments.evaluation._judge_estimator", record)
    run_job(Job("SVM", "leave objects out", "raw", 0, 0), TRAIN, TEST, 2)
    train, test = seen["groups"]
    assert train
    assert test
    assert not train & test


def test_summary_has_a_record_for_each_session_of_unseen_objects():
    job = Job("Majority", "unseen objects", "raw", 0, 0)
    records = list(summarize(dict([run_job(job, TRAIN, TEST, 2)]), TEST.session_names))
    assert [record["protocol"] for record in records] == [
        "unseen objects",
        "palm down",
        "palm side",
        "palm 45",
    ]
    assert sum(record["num_samples"] for record in records[1:]) == records[0]["num_samples"] == 60
