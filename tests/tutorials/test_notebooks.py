import base64
import importlib
import io
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jupytext", reason="needs the extra 'docs'")
pytest.importorskip("nbclient", reason="needs the extra 'docs'")
pytest.importorskip("ipykernel", reason="needs the extra 'docs'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

import nbformat
from PIL import Image

FOLDER = Path(__file__).parents[2] / "tutorials"
sys.path.append(str(FOLDER))  # stays: the processes that run tutorials import from there as well
form, outputs, run, to_notebooks = map(
    importlib.import_module, ("form", "outputs", "run", "to_notebooks")
)

SCRIPTS = form.script_paths()
GOOD = """\
# %% [markdown]
# # Sums: do they add up?
# A small tutorial.

# %%
total = sum([1, 2])
assert total == 3

# %% tags=["figure"]
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(1, 1))
axes.plot([1, 2], [1, total])
plt.show()

# %% tags=["figure"]
figure, axes = plt.subplots(figsize=(1, 1))
axes.bar([1, 2], [1, total])

# %% [markdown]
# ## What to take from this
# - They do.
#
# ## Next
# [A new day](04_new_day.py), [scaling](../docs/scaling.md#common-mode)
"""


@pytest.fixture
def script(tmp_path):
    def write(text, name="01_real_grasps"):
        path = tmp_path / f"{name}.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.full
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_tutorial_has_the_form(path):
    assert path.stem in form.NAMES
    assert form.form_problems(path) == []


def test_notebooks_are_those_of_the_scripts():
    assert to_notebooks.out_of_step(SCRIPTS, FOLDER / "notebooks") == []


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_notebook_is_small_and_opens_elsewhere(path):
    file = FOLDER / "notebooks" / f"{path.stem}.ipynb"
    assert file.stat().st_size < 500_000
    notebook = json.loads(file.read_text("utf-8"))
    assert 5 < notebook["metadata"]["processor_seconds"] < 100
    codes = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    (install,) = (cell for cell in codes if "%pip install" in "".join(cell["source"]))
    assert (install["outputs"], install["execution_count"]) == ([], None)
    first = "".join(notebook["cells"][0]["source"])
    assert f"tutorials/notebooks/{path.stem}.ipynb" in first  # Colab
    assert f"tutorials%2Fnotebooks%2F{path.stem}.ipynb" in first  # Binder


def test_good_script_has_the_form(script):
    assert form.form_problems(script(GOOD)) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("# # Sums", "# Sums", "must be Markdown that begins with '# Title"),
        ("add up?", "add up.", "must ask a question"),
        ('%% tags=["figure"]\nimport', "%%\nimport", "two cells must be tagged as figures"),
        ("assert total == 3", "", "must hold an 'assert' about a result"),
        ("assert total == 3", "assert True", "must hold an 'assert' about a result"),
        ("## What to take", "## What we took", "the heading 'What to take from this' is missing"),
        ("## Next", "## And then", "the heading 'Next' is missing"),
        ("scaling.md", "skaling.md", "the link '../docs/skaling.md' leads nowhere"),
        ("04_new_day.py", "04_old_day.py", "the link '04_old_day.py' leads nowhere"),
    ],
)
def test_script_without_the_form_is_told(script, old, new, problem):
    assert old in GOOD
    (found,) = form.form_problems(script(GOOD.replace(old, new)))
    assert problem in found


@pytest.fixture
def executed(script):
    """The notebook of GOOD with outputs, beside the script."""
    path = script(GOOD)
    notebook = form.read_script(path)
    for number, cell in enumerate(to_notebooks.code_cells(notebook), start=1):
        cell.execution_count = number
        if form.is_figure(cell):
            data = {"image/png": png([[0, 0, 0], [250, 9, 9]]), "text/plain": "<Figure>"}
            cell.outputs = [nbformat.v4.new_output("display_data", data)]
    notebook.metadata["processor_seconds"] = 7
    file = path.with_suffix(".ipynb")
    nbformat.write(notebook, file)
    return file


def png(colours):
    file = io.BytesIO()
    pixels = np.array([colours], dtype=np.uint8)
    Image.fromarray(pixels).save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode()


def test_written_notebook_has_the_outputs_until_the_code_changes(
    script, executed, tmp_path, capsys
):
    path, folder = executed.with_suffix(".py"), tmp_path / "notebooks"
    check = ["--check", "--scripts", str(tmp_path)]
    assert to_notebooks.main(check) == 1
    assert "01_real_grasps.ipynb is missing; run: python tut" in capsys.readouterr().err
    to_notebooks.write_notebook(path, executed, folder)
    assert to_notebooks.main(check) == 0
    written = json.loads((folder / executed.name).read_text("utf-8"))
    assert written["metadata"]["processor_seconds"] == 7
    assert [cell.get("execution_count") for cell in written["cells"]] == [None, None, 1, 2, 3, None]
    (output,) = written["cells"][3]["outputs"]
    assert list(output["data"]) == ["image/png"]

    script(GOOD.replace("A small", "A tiny"))
    assert to_notebooks.main(check) == 1
    assert "01_real_grasps.ipynb is not the notebook of" in capsys.readouterr().err
    assert to_notebooks.main(check[1:]) == 0
    assert to_notebooks.main(check) == 0
    tiny = json.loads((folder / executed.name).read_text("utf-8"))
    assert tiny["cells"][3:5] == written["cells"][3:5]

    script(GOOD.replace("[1, 2]", "[2, 1]"))
    for arguments in (check, check[1:]):
        assert to_notebooks.main(arguments) == 1
        told = "the code of 01_real_grasps.ipynb is not that of 01_real_grasps.py; run: python"
        assert told in capsys.readouterr().err


def test_notebook_of_no_script_is_removed(executed, tmp_path, capsys):
    path, folder = executed.with_suffix(".py"), tmp_path / "notebooks"
    to_notebooks.write_notebook(path, executed, folder)
    path.rename(tmp_path / "02_your_own_glove.py")
    assert to_notebooks.main(["--check", "--scripts", str(tmp_path)]) == 1
    assert "01_real_grasps.ipynb has no script" in capsys.readouterr().err
    assert to_notebooks.main(["--scripts", str(tmp_path)]) == 1
    assert "02_your_own_glove.ipynb is missing" in capsys.readouterr().err
    assert list(folder.iterdir()) == []


def test_cells_that_were_not_run_are_told(executed, tmp_path):
    notebook = nbformat.read(executed, as_version=4)
    notebook.cells[1].execution_count = None
    notebook.cells[2].outputs = []
    nbformat.write(notebook, executed)
    path, folder = executed.with_suffix(".py"), tmp_path / "notebooks"
    to_notebooks.write_notebook(path, executed, folder)
    assert to_notebooks.out_of_step([path], folder) == [
        "01_real_grasps.ipynb: the cell 'total = sum([1, 2])' was not run",
        "01_real_grasps.ipynb: the figure cell 'import matplotlib.pyplot as plt' shows no picture",
    ]


def cell(source, *outs):
    return nbformat.v4.new_code_cell(source, execution_count=1, outputs=list(outs))


@pytest.mark.parametrize(
    ("source", "text", "problem"),
    [
        ("print(1)", "1", None),
        ("print(1)", "", "prints and has no output"),
        ("for i in range(2):\n    print(i)", "", "prints and has no output"),
        ("def told():\n    print(1)", "", None),
        ("a", "1 \x1b[31mWarning", "prints a warning: 1 Warning"),
        ("a", str(Path.home() / "a.csv"), "prints a path of this machine: /"),
        ("a", "/tmp/tmp12345678/a.csv", "prints a path of this machine: /tmp"),
        ("a", "<Legend at 0x7f2ad6e1bbd0>", "shows an object by its address: <Legend"),
        ("a", "the folder docs/home/tmp/", None),
    ],
)
def test_wrong_outputs_are_told(source, text, problem):
    outs = [nbformat.v4.new_output("stream", text=text)] if text else []
    problems = outputs.output_problems(cell(source, *outs))
    assert len(problems) == (problem is not None)
    assert all(problem in told for told in problems)


def test_stored_pictures_have_few_colours_near_the_true_ones():
    colours = [[r, g, 128] for r in range(0, 256, 8) for g in range(0, 256, 8)]
    output = nbformat.v4.new_output("display_data", {"image/png": png(colours)})
    stored = outputs.to_stored(output)
    image = Image.open(io.BytesIO(base64.b64decode(stored.data["image/png"])))
    assert image.mode == "P"
    error = np.abs(np.asarray(image.convert("RGB")).astype(int) - [colours])
    assert error.max() <= 10  # 16 with the method that is Pillow's default
    assert outputs.to_stored(stored) == stored
    stream = nbformat.v4.new_output("stream", text="1")
    assert outputs.to_stored(stream) == stream


def test_links_of_a_notebook_lead_to_the_repository(executed):
    path = executed.with_suffix(".py")
    assert form.relative_links(form.read_script(path)) == ["04_new_day.py", "../docs/scaling.md"]
    text = to_notebooks.notebook_text(path, executed)
    assert f"({to_notebooks.GITHUB}/blob/main/docs/scaling.md#common-mode)" in text
    assert f"({to_notebooks.GITHUB}/blob/main/tutorials/notebooks/04_new_day.ipynb)" in text


@pytest.mark.parametrize("names", [["1"], ["11"], ["0"]], ids=str)
def test_unknown_tutorial_is_refused(script, tmp_path, names, capsys):
    script(GOOD)
    script(GOOD, "02_your_own_glove")
    with pytest.raises(SystemExit, match="2"):
        run.main([*names, "--scripts", str(tmp_path)])
    assert "must be the name of one tutorial of: 01_real_grasps, 02_you" in capsys.readouterr().err


def test_names_may_be_paths(script, tmp_path):
    path = script(GOOD)
    script(GOOD, "02_your_own_glove")
    assert form.script_paths(["01"], tmp_path) == [path]
    assert form.script_paths([f"tutorials/{path.name}"], tmp_path) == [path]


def run_one(script, text, tmp_path, monkeypatch, capsys, *arguments):
    script(text)
    monkeypatch.setenv("TACTILE_DATA", str(tmp_path))
    status = run.main(["--scripts", str(tmp_path), "--out", str(tmp_path / "out"), *arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_good_tutorial_runs(script, tmp_path, monkeypatch, capsys):
    status, out, err = run_one(script, GOOD, tmp_path, monkeypatch, capsys, "--write")
    assert (status, err) == (0, "")
    assert to_notebooks.main(["--check", "--scripts", str(tmp_path)]) == 0
    name, result, processor, wall, memory, figures = out.splitlines()[1].split()
    assert (name, result, figures) == ("01_real_grasps", "ok", "2")
    assert min(float(wall), float(processor)) > 0
    assert float(memory) > 10
    executed = json.loads((tmp_path / "out" / "01_real_grasps.ipynb").read_text("utf-8"))
    pictures = ["image/png" in str(cell.get("outputs")) for cell in executed["cells"]]
    assert pictures == [False, False, True, True, False]
    assert "(../docs/scaling.md#common-mode)" in str(executed["cells"][-1])  # as in the script


# All faults in one tutorial, since each run starts a kernel.
FAULTS = {
    "axes.plot([1, 2], [1, total])": "plt.close()",
    "axes.bar([1, 2], [1, total])": "axes.set_axis_off()",
    "total = sum([1, 2])": (
        'import sys, warnings\nprint("told", file=sys.stderr)\n'
        'print("UserWarning: old")\ntotal = sum([1, 2])'
    ),
}


def test_faults_of_a_tutorial_are_told(script, tmp_path, monkeypatch, capsys):
    text = GOOD
    for old, new in FAULTS.items():
        assert old in text
        text = text.replace(old, new)
    text += "\n# %%\nassert total == 4\n"
    limits = ["--limit", "0.01", "--memory", "0.001", "--total", "0.02"]
    status, out, err = run_one(script, text, tmp_path, monkeypatch, capsys, *limits, "--write")
    assert status == 1
    assert not (tmp_path / "notebooks").exists()
    assert "FAILED" in out
    assert "the cell 'import sys, warnings' writes to stderr: told" in err
    assert "the cell 'import sys, warnings' prints a warning: UserWarning: old" in err
    assert "the figure cell 'import matplotlib.pyplot as plt' shows no picture" in err
    assert "the figure cell 'figure, axes = plt.subplots(figsize=(1, 1))' shows no picture" in err
    assert "a cell raises AssertionError" in err
    assert re.search(r"01_real_grasps: it takes \d+ s of processor time, more than 0.01 s", err)
    assert re.search(r"together: it takes \d+ s of processor time, more than 0.02 s", err)
    assert "GB of memory, more than 0.001 GB" in err


@pytest.mark.full
def test_tutorial_without_its_data_is_skipped_with_the_reason(
    script, tmp_path, monkeypatch, capsys
):
    missing = "raise ConnectionError(\"'a.csv' is not in 'b'; put the file there by hand\")"
    text = GOOD.replace("total = sum([1, 2])", missing)
    status, out, err = run_one(script, text, tmp_path, monkeypatch, capsys)
    assert (status, err) == (0, "")
    assert "01_real_grasps skipped: 'a.csv' is not in 'b'" in out


@pytest.mark.full
def test_other_connection_errors_are_failures(script, tmp_path, monkeypatch, capsys):
    text = GOOD.replace("total = sum([1, 2])", 'raise ConnectionError("no robot")')
    status, _, err = run_one(script, text, tmp_path, monkeypatch, capsys)
    assert status == 1
    assert "a cell raises ConnectionError: no robot" in err


def test_data_is_linked_and_never_written_to(tmp_path, monkeypatch):
    monkeypatch.delenv("TACTILE_DATA", raising=False)
    for name in ("a.csv", "processed/biotac_sp.pt"):
        path = tmp_path / "data" / "biotacsp" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1")
    for _ in range(2):
        run.link_data(tmp_path / "data", tmp_path / "linked")
    linked = Path(run.os.environ["TACTILE_DATA"]) / "biotacsp"
    assert (linked / "a.csv").read_text() == "1"
    assert [path.name for path in linked.iterdir()] == ["a.csv"]
    (linked / "processed").mkdir()
    (linked / "processed" / "biotac_sp.pt").write_text("2")
    assert (tmp_path / "data" / "biotacsp" / "processed" / "biotac_sp.pt").read_text() == "1"


class FakeShell:
    def __init__(self):
        self.calls = []

    def system(self, command):
        self.calls.append(f"!{command}")

    def run_line_magic(self, name, line):
        self.calls.append(f"%{name} {line}")


@pytest.mark.parametrize(
    ("installed", "start", "calls", "end"),
    [
        (True, "tutorials", [], "tutorials"),
        (True, "tutorials/notebooks", [], "tutorials"),
        (False, "", ["!git clone --quiet", "%pip install --quiet"], "tactile/tutorials"),
    ],
)
def test_install_cell_leads_to_the_tutorials(tmp_path, monkeypatch, installed, start, calls, end):
    from IPython.core.inputtransformer2 import TransformerManager

    (tmp_path / "tutorials" / "notebooks").mkdir(parents=True)
    (tmp_path / "tactile" / "tutorials").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / start)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if installed else None)
    shell = FakeShell()
    code = TransformerManager().transform_cell(to_notebooks.INSTALL)
    exec(code, {"get_ipython": lambda: shell})
    assert [" ".join(call.split()[:3]) for call in shell.calls] == calls
    assert Path.cwd() == tmp_path / end


def test_extras_of_notebooks_are_those_of_binder_and_exist():
    import tomllib

    pyproject = tomllib.loads((FOLDER.parent / "pyproject.toml").read_text("utf-8"))
    extras = to_notebooks.EXTRAS.split(",")
    assert set(extras) <= set(pyproject["project"]["optional-dependencies"])
    assert f'".[{to_notebooks.EXTRAS}]"' in (FOLDER.parent / "binder" / "postBuild").read_text()
