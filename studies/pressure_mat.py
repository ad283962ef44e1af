r"""Seventeen postures on a pressure mat: models on new persons.

Of experiment I of the pressure mat data, 64 x 32 pressures of a frame are pooled by two, and every
eighth frame is taken. One person is held out in turn, thirteen in all.

Examples:
    PYTHONPATH=benchmarks python studies/pressure_mat.py --data shared/data --out mat
    PYTHONPATH=benchmarks python studies/pressure_mat.py --data shared/data --out mat --models forest,svm_rbf
"""

from pathlib import Path

import numpy as np
from few_labels import mat
from shared import describe_machine, parse

from torch_geometric_tactile.experiments import advice
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings, compare

_PERSONS = 13


def main() -> None:
    options = parse(
        __doc__,
        {
            "--data": (Path("shared/data"), "folder of the real data"),
            "--out": (Path("mat"), "folder of runs"),
            "--models": ("taxel_net,cnn,svm_rbf,forest,descriptors_svm,descriptors_forest", "rows"),
            "--members": (3, "networks that are averaged"),
        },
    )
    print(describe_machine())
    x, y, person, layout = mat(options.data, options.out)
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
