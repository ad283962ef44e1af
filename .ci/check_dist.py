"""Checks size and contents of the wheel and the sdist in a folder, and runs tests of the sdist."""

import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

MAX_WHEEL_BYTES = 2_600_000  # 0.6 MB of them are trained predictors
MAX_SDIST_BYTES = 3_600_000  # with the tests
NEEDED = (
    "py.typed",
    "io/__init__.pyi",
    "configs/grasp_gcn_df.yaml",
    "papers/tables.yaml",
    "predictor/pretrained/biotac_sp_slip.predictor",
    "predictor/pretrained/pressure_mat_side.predictor",
    "predictor/pretrained/simulated_hand_shape.predictor",
    "live/taxel_maps/xela_allegro_368.json",
    "live/_viewer/viewer.html",
    "reports/report.html",
    "sensors/chains/allegro_right.json",
    "sensors/layouts/biotac_sp.json",
)
PACKAGE = "torch_geometric_tactile"
REPOSITORY_ONLY = ("benchmarks", "studies", "docs", "tutorials", "build")
# Need no file outside of the package and the tests, and take seconds.
SDIST_TESTS = ("tests/sensors/test_layout.py", "tests/transforms/test_common_mode.py")


def failed_sdist_tests(sdist):
    """Yields the end of the output if the tests in an sdist fail."""
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(sdist) as file:
            file.extractall(folder, filter="data")
        (root,) = Path(folder).iterdir()
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *SDIST_TESTS],
            cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, capture_output=True, text=True,
        )  # fmt: skip
    if done.returncode:
        yield f"tests in {sdist.name} fail: {(done.stdout + done.stderr)[-2000:]}"


def problems(folder):
    """Yields what is wrong with the distributions of a folder."""
    (wheel,) = folder.glob("torch_geometric_tactile-*.whl")
    (sdist,) = folder.glob("*.tar.gz")
    for path, max_bytes in ((wheel, MAX_WHEEL_BYTES), (sdist, MAX_SDIST_BYTES)):
        if path.stat().st_size > max_bytes:
            yield f"{path.name} has {path.stat().st_size} bytes, more than {max_bytes}"
    with zipfile.ZipFile(wheel) as file:
        in_wheel = set(file.namelist())
        (metadata,) = (name for name in in_wheel if name.endswith(".dist-info/METADATA"))
        page = file.read(metadata).decode()
    with tarfile.open(sdist) as file:
        in_sdist = {name.partition("/")[2] for name in file.getnames()}
    source = Path(__file__).parents[1]
    modules = {str(p.relative_to(source).as_posix()) for p in (source / PACKAGE).rglob("*.py")}
    needed = {*modules, *(f"{PACKAGE}/{name}" for name in NEEDED)}
    tests = {str(p.relative_to(source).as_posix()) for p in (source / "tests").rglob("*.py")}
    for names, kind, required, excluded in (
        (in_wheel, wheel.name, needed, (*REPOSITORY_ONLY, "tests")),
        (in_sdist, sdist.name, needed | tests, REPOSITORY_ONLY),
    ):
        for name in sorted(required - names):
            yield f"{kind} lacks {name}"
        for name in sorted(names):
            if name.split("/")[0] in excluded:
                yield f"{kind} must not have {name}"
    yield from failed_sdist_tests(sdist)
    version = re.search(r"^Version: (.*)$", page, re.MULTILINE)[1]
    for link in re.findall(r"https://raw\.githubusercontent\.com/[^)\"]*", page):
        if f"/v{version}/" not in link:
            yield f"the long description has a picture that is not of v{version}: '{link}'"
    for link in re.findall(r"\]\((?!https?://|#)([^)]*)\)", page):
        yield f"the long description has the relative link '{link}'"


if __name__ == "__main__":
    found = list(problems(Path(sys.argv[1])))
    print("\n".join(found) or f"the distributions in '{sys.argv[1]}' are complete and small")
    sys.exit(bool(found))
