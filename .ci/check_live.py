"""Tries the wheel of `tactile-live` in an empty environment: python check_live.py DIST."""

import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

SOURCE = Path(__file__).parents[1]
sys.path[:0] = [str(SOURCE), str(SOURCE / "tests")]

import onnx_predictors as made  # noqa: E402

from torch_geometric_tactile import __version__  # noqa: E402
from torch_geometric_tactile.commands import COMMANDS  # noqa: E402
from torch_geometric_tactile.io import read_recording, write_recording  # noqa: E402

PACKAGE = "torch_geometric_tactile"
LARGEST = 400e6  # bytes of the environment; that of the whole package has gigabytes


def main(folder):
    """Installs the wheel, uses it, and installs the whole package beside it."""
    (wheel,) = folder.glob("tactile_live-*.whl")
    (whole,) = folder.glob("torch_geometric_tactile-*.whl")
    with tempfile.TemporaryDirectory() as place:
        place = Path(place)
        venv.create(place / "env", with_pip=True)
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        scripts = place / "env" / "bin"

        def run(*words, fails=False):
            done = subprocess.run(
                [str(scripts / words[0]), *map(str, words[1:])],
                cwd=place, env=environment, capture_output=True, text=True, timeout=600,
            )  # fmt: skip
            text = done.stdout + done.stderr
            assert (done.returncode != 0) == fails, f"{words}: {text}"
            return text

        def pip(*words):
            return run("python", "-m", "pip", "--quiet", "--disable-pip-version-check", *words)

        pip("install", "--constraint", SOURCE / "constraints.txt", wheel)
        size = sum(path.stat().st_size for path in (place / "env").rglob("*") if path.is_file())
        assert size < LARGEST, f"the environment has {size} bytes"
        names = [re.split("[= ]", line)[0] for line in pip("freeze").splitlines()]
        assert not {"torch", "torch-geometric", "scikit-learn", "umap-learn"} & set(names), names

        # A recording is replayed, judged by an exported model, recorded and converted.
        recording = made.recording()
        write_recording(recording, place / "whole.npz")
        model = made.onnx_file("frame")
        text = run(
            "tactile",
            "live",
            "whole.npz",
            "--model",
            model,
            "--record",
            "a.mcap",
            "--policy",
            "all",
        )
        count = recording.num_frames
        assert f"{count} frames, {count} judged" in text, text
        run("tactile", "convert", "a.mcap", "b.npz")
        assert read_recording(place / "b.npz").num_frames == count
        page = run("tactile", "--help")
        listed = [verb for verb in COMMANDS if re.search(rf"^    {verb}\s", page, re.MULTILINE)]
        assert sorted(listed) == ["convert", "live", "ports", "record", "replay", "view"], page
        assert "tactile live " in page, page  # among the examples
        assert "tactile fit " not in page, page
        text = run("tactile", "live", "whole.npz", "--model", "a.predictor", fails=True)
        assert 'pip install "torch-geometric-tactile' in text, text

        # docs/install.md: in either order, no file belongs to both, the whole package is imported
        # where it is there, and what stays after the other is removed works.
        for first, second in ((wheel, whole), (whole, wheel)):
            pip("uninstall", "--yes", "tactile-live", "torch-geometric-tactile")
            for removed in (whole, wheel):
                pip("install", "--no-deps", "--force-reinstall", first)
                pip("install", "--no-deps", "--force-reinstall", second)
                page = run("python", "-m", PACKAGE, "--help")
                assert all(re.search(rf"^    {verb}\s", page, re.MULTILINE) for verb in COMMANDS), (
                    page
                )
                assert __version__ in run("tactile", "--version")
                pip("uninstall", "--yes", re.match(r"\w+", removed.name)[0].replace("_", "-"))
                page = run("python", "-m", PACKAGE, "--help")
                kept = "live" if removed == whole else "fit"
                assert re.search(rf"^    {kept}\s", page, re.MULTILINE), page
                assert bool(re.search(r"^    fit\s", page, re.MULTILINE)) == (removed == wheel), (
                    page
                )
                run("python", "-c", f"import {PACKAGE}.io, {PACKAGE}.live")
                if removed == whole:
                    assert __version__ in run("tactile-live", "--version")
    print(
        f"tactile-live {__version__} works without PyTorch in {size / 1e6:.0f} MB: {sorted(names)}"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
