"""Flips single bits of whole files, and counts what is refused, equal, or silently different.

python tests/fuzz/flips.py --flips 300
"""

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path
from random import Random

import torch

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).resolve().parents[i]) for i in (1, 2)]

from fuzz.laws import difference, equal
from fuzz.run import FORK, preload
from fuzz.targets import TARGETS, Target

NAMES = (
    *("npz", "MCAP", "HDF5", "HDF5, appended", "processed file", "checkpoint: predictor"),
    *("checkpoint: module", "predictor", "model folder: weights"),
)


def flipped(target: Target, folder: Path, flips: int, seed: int) -> tuple[Counter[str], list[str]]:
    """The outcomes of flips in the files of a target, and a line for each silent one."""
    outcomes: Counter[str] = Counter()
    silent: list[str] = []
    files = sorted(path for path in folder.iterdir() if path.name.endswith(target.suffix))
    draw = Random(f"{seed} {target.name}")
    whole = {path: (path.read_bytes(), target.read(path)) for path in files}
    for number in range(flips):
        path = draw.choice(files)
        data, before = whole[path]
        bit = draw.randrange(8 * len(data))
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        # A folder of its own: nothing may be known of the file.
        place = folder / f"flip{number}"
        place.mkdir()
        for other in folder.iterdir():
            if other.is_file() and other != path:
                (place / other.name).write_bytes(other.read_bytes())
        (place / path.name).write_bytes(changed)
        try:
            found = target.read(place / path.name)
        except (ValueError, OSError):
            outcomes["refused"] += 1
        except Exception as error:
            outcomes["other error"] += 1
            silent.append(
                f"{target.name}: bit {bit} of {path.name}: {type(error).__name__}: {error}"
            )
        else:
            same = equal(found, before)
            outcomes["same" if same else "silently different"] += 1
            if not same:
                change = difference(before, found)
                silent.append(
                    f"{target.name}: bit {bit} of {path.name} ({len(data)} bytes): {change}"
                )
    return outcomes, silent


def main() -> int:
    """Runs the flips."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--flips", type=int, default=300, help="flips in the files of each format")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    preload()
    columns = ("refused", "same", "silently different", "other error")
    sys.stdout.write(
        f"{'':24} {'bytes':>12} " + " ".join(name.rjust(18) for name in columns) + "\n"
    )
    bad: list[str] = []
    with tempfile.TemporaryDirectory(prefix="flips_") as root, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for target in TARGETS:
            if target.name not in NAMES:
                continue
            folder = Path(root) / target.name
            folder.mkdir()
            maker = FORK.Process(target=target.make, args=(folder,))
            maker.start()
            maker.join()
            outcomes, silent = flipped(target, folder, options.flips, options.seed)
            bad += silent
            sizes = [
                p.stat().st_size
                for p in folder.iterdir()
                if p.name.endswith(target.suffix) and p.is_file()
            ]
            counts = " ".join(str(outcomes[name]).rjust(18) for name in columns)
            sys.stdout.write(f"{target.name:24} {'+'.join(map(str, sizes)):>12} {counts}\n")
    sys.stdout.write("".join(f"{line}\n" for line in bad))
    return int(bool(bad))


if __name__ == "__main__":
    torch.set_num_threads(1)  # threads do not survive a fork
    sys.exit(main())
