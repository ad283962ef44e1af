r"""Seventeen postures on a pressure mat: models on new persons, and what square roots change.

Of experiment I of the pressure mat data, 64 x 32 pressures of a frame are pooled by two, and every
eighth frame is taken. One person is held out in turn, thirteen in all.

Examples:
    python benchmarks/pressure_mat.py --data shared/data --out mat
    python benchmarks/pressure_mat.py --data shared/data --out mat --show roots
"""

from pathlib import Path

import numpy as np
import torch
from few_labels import mat
from shared import describe_machine, parse
from sklearn.base import clone

from torch_geometric_tactile.baselines import (
    descriptor_forest,
    descriptor_svm,
    flat_forest,
    rbf_svm,
)
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments import advice
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings, compare
from torch_geometric_tactile.transforms import SquareRoot, ZScore

_PERSONS = 13


def square_roots(x: np.ndarray, y: np.ndarray, person: np.ndarray, layout: object) -> None:
    """Prints the accuracy of estimators on readings and on their square roots."""
    readings = StaticData(x=torch.from_numpy(x.astype(np.float32)))
    forms = {"readings": readings, "square roots": SquareRoot()(readings.clone())}
    models = {
        "forest": flat_forest(),
        "svm_rbf": rbf_svm(C=10.0),
        "descriptors_forest": descriptor_forest(layout, balanced=False),
        "descriptors_svm": descriptor_svm(layout),
    }
    for name, model in models.items():
        for form, samples in forms.items():
            right = []
            for one in np.unique(person):
                parts = (np.flatnonzero(person != one), np.flatnonzero(person == one))
                train, test = map(torch.from_numpy, parts)
                seen = samples.index_select(train)
                scale = ZScore(scale_per="channel", with_mean=not name.startswith("desc")).fit(seen)
                last = clone(model).set_params(**{f"{model.steps[-1][0]}__random_state": 0})
                last.fit(scale(seen).x.numpy(), y[train])
                predicted = last.predict(scale(samples.index_select(test)).x.numpy())
                right.append(100 * float((predicted == y[test]).mean()))
            mean, sd = np.mean(right), np.std(right, ddof=1)
            print(f"{name} on {form}: {mean:.1f} ± {sd:.1f}", flush=True)


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("mat"), "folder of runs"),
            "--models": ("taxel_net,cnn,svm_rbf,forest,descriptors_svm,descriptors_forest", "rows"),
            "--members": (3, "networks that are averaged"),
            "--show": ("models", "what is compared", ("models", "roots")),
        },
    )
    print(describe_machine())
    x, y, person, layout = mat(options.data, options.out)
    if options.show == "roots":
        square_roots(x, y, person, layout)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "mat.npz"
    layout.save(options.out / "mat.json")
    np.savez(path, x=x.astype(np.float32), y=y, trial=person)
    settings = ComparisonSettings(
        models=tuple(options.models.split(",")), folds=_PERSONS, members=options.members
    )
    source = data_source(path, layout=str(options.out / "mat.json"))
    comparison = compare(source, settings, options.out)
    for result in comparison.results:
        mean, sd = (100 * value for value in result.scores["accuracy"])
        print(f"{result.model.name}: {mean:.1f} ± {sd:.1f}")
        if result.model.name != "forest":
            print(comparison.difference(result.model.name, "forest"))
    print(advice(comparison))


if __name__ == "__main__":
    main()
