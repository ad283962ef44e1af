r"""Makes ``hand.predictor``, the shipped model of tutorial 10: which shape does the hand hold?

It simulates 600 grasps of 40 drawn objects and 80 grasps of 80 other objects, trains a
:class:`~torch_geometric_tactile.nn.PosedTaxelNet` on four fifths of the 600 grasps, and measures
its accuracy on the other fifth and on the other objects. ``hand.json`` states the data and these
numbers. Everything is simulated; nothing is a result on a real hand. Finished grasps are kept, so
an interrupted run resumes.

Examples:
    python tutorials/data/make_predictor.py --data /tmp/shapes
"""

import argparse
import json
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from torch_geometric_tactile import Predictor
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.data import Protocol, StaticData
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.nn import PosedTaxelNet
from torch_geometric_tactile.sim import GraspSpread, simulate
from torch_geometric_tactile.training import training_recipe
from torch_geometric_tactile.transforms import TaxelPose

HERE = Path(__file__).parent
TRAINED = {"objects": 40, "trials": 15, "seed": 0}
OTHERS = {"objects": 80, "trials": 1, "seed": 1}
PHASES = ("squeeze", "lift", "hold")
STRIDE = 40


def frames(root: Path, objects: int, trials: int, seed: int, jobs: int) -> AllegroUSkin:
    """Returns every 40th frame with touch of simulated grasps, minus the hover of their trial."""
    for _ in simulate(
        root,
        "shapes",
        trials,
        seed,
        jobs,
        preset="ci",
        plan=GraspSpread.wide(),
        seconds=5,
        num_objects=objects,
    ):
        pass
    return AllegroUSkin(root, task="shape", split=None, phases=PHASES, stride=STRIDE, tare="hover")


def train(data: StaticData, y: Tensor, num_classes: int) -> PosedTaxelNet:
    """Trains with the recipe of the package; nothing is chosen on held-out trials."""
    torch.manual_seed(0)
    model = PosedTaxelNet("allegro_uskin", num_classes)
    recipe = training_recipe(len(y))
    steps = len(y) // recipe.batch_size
    optimizer = torch.optim.AdamW(model.parameters(), recipe.lr, weight_decay=recipe.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.lr, recipe.max_epochs * steps, cycle_momentum=False
    )
    for _ in range(recipe.max_epochs):
        for rows in torch.randperm(len(y)).split(recipe.batch_size)[:steps]:
            optimizer.zero_grad()
            logits = model(
                data.x[rows],
                pos=data.pos[rows],
                normal=data.normal[rows],
                tangent=data.tangent[rows],
            )
            cross_entropy(logits, y[rows], label_smoothing=recipe.label_smoothing).backward()
            optimizer.step()
            schedule.step()
    return model.eval()


def accuracy(predictor: Predictor, dataset: AllegroUSkin, rows: Tensor) -> dict[str, float | int]:
    """Returns the accuracy by frame, and how much it rests on."""
    batch = dataset.batch(rows)
    right = predictor(batch.x, batch.joint).argmax(dim=1) == batch.y
    trials = len(batch.trial.unique())
    return {
        "accuracy": round(float(right.double().mean()), 4),
        "frames": len(rows),
        "trials": trials,
    }


def main() -> int:
    """Makes the predictor and the file beside it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder for simulated grasps")
    parser.add_argument("--jobs", type=int, default=2, help="processes of the simulation")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of hand.predictor")
    arguments = parser.parse_args()
    dataset = frames(arguments.data / "trained", jobs=arguments.jobs, **TRAINED)
    others = frames(arguments.data / "others", jobs=arguments.jobs, **OTHERS)
    split = Protocol("trial", folds=5, stratify="group").split(dataset, fold=0)
    batch = dataset.batch(split.train)
    # The network uses no edges, and a file without them is a third smaller.
    layout = replace(dataset.layout, adjacency={})
    transform = TaxelPose(layout, tangent=True)
    placed = transform(StaticData(x=batch.x, joint=batch.joint))
    model = train(placed, batch.y, dataset.num_classes)
    predictor = Predictor(
        model,
        layout,
        transform,
        dataset.class_names,
        num_channels=3,
        num_joints=16,
    )
    predictor.save(arguments.out / "hand.predictor")
    # Measured with the file, not with the model in memory.
    predictor = Predictor.load(arguments.out / "hand.predictor")
    card = {
        "synthetic": True,
        "model": repr(model),
        "task": "shape of the object from one frame of 384 taxels and 16 joint angles",
        "classes": list(dataset.class_names),
        "readings": "counts minus the mean hover reading of the trial",
        "data": "tactile simulate --objects shapes --num-objects 40 --trials 15 --spread wide "
        "--seconds 5 --preset ci --seed 0",
        "frames": f"every {STRIDE}th frame of {', '.join(PHASES)}",
        "trained_on": {"frames": len(split.train), "trials": len(batch.trial.unique())},
        "held_out_trials_of_the_same_objects": accuracy(predictor, dataset, split.test),
        "80_other_objects_one_trial_each": accuracy(predictor, others, torch.arange(len(others))),
        "versions": {name: version(name) for name in ("torch", "mujoco")},
    }
    text = json.dumps(card, indent=2)
    with atomic_path(arguments.out / "hand.json") as path:
        path.write_text(text + "\n")
    sys.stdout.write(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
