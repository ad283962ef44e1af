"""Checks the size and the contents of the wheel and the sdist in a folder."""

import re
import sys
import tarfile
import zipfile
from pathlib import Path

MOST_BYTES = 2_600_000  # 0.6 MB of them are trained predictors
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
REPOSITORY_ONLY = ("tests", "benchmarks", "studies", "docs", "tutorials", "build")


def problems(folder):
    """Yields what is wrong with the distributions of a folder."""
    (wheel,) = folder.glob("torch_geometric_tactile-*.whl")
    (sdist,) = folder.glob("*.tar.gz")
    for path in (wheel, sdist):
        if path.stat().st_size > MOST_BYTES:
            yield f"{path.name} has {path.stat().st_size} bytes, more than {MOST_BYTES}"
    with zipfile.ZipFile(wheel) as file:
        in_wheel = set(file.namelist())
        (metadata,) = (name for name in in_wheel if name.endswith(".dist-info/METADATA"))
        page = file.read(metadata).decode()
    with tarfile.open(sdist) as file:
        in_sdist = {name.partition("/")[2] for name in file.getnames()}
    source = Path(__file__).parents[1]
    modules = {str(p.relative_to(source).as_posix()) for p in (source / PACKAGE).rglob("*.py")}
    for names, kind in ((in_wheel, wheel.name), (in_sdist, sdist.name)):
        for name in sorted({*modules, *(f"{PACKAGE}/{name}" for name in NEEDED)} - names):
            yield f"{kind} lacks {name}"
        for name in sorted(names):
            if name.split("/")[0] in REPOSITORY_ONLY:
                yield f"{kind} must not have {name}"
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
