import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.io import read_recording

PAGE = (Path(__file__).parents[1] / "docs" / "bigs.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


def run(command):
    words = shlex.split(command.replace("\\\n", " "))
    assert words[0] == "tactile"
    return main(words[1:])


@pytest.mark.filterwarnings("ignore")
def test_the_page_leads_from_logs_to_a_data_set(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    load, log, look = blocks("python")
    convert, inspect = blocks("sh")
    exec(log, {})
    assert run(convert) == 0
    assert run(inspect) == 0
    assert "extra        pressure (500, 3)" in capsys.readouterr().out
    names = {}
    exec(load, names)
    assert "pac" not in names["dataset"].data
    exec(look, names)
    dataset = names["dataset"]
    assert dataset.group_names == ["ball", "box", "cylinder"]
    assert dataset.y.view(3, 401)[:, 0].tolist() == [1, 0, 1]  # 2 s up to pick-up and 2 s after it
    stored = np.load("log_1.npz")
    rec = read_recording("bigs/log_1.npz")
    assert (rec.label, rec.meta["object"], rec.meta["trial"]) == ("failure", "box", 1)
    # Electrode 5 of the middle finger, the fourth PAC value of a frame, a joint in its second step.
    assert np.array_equal(rec.tactile[:, 4, 1], stored["elec"][:, 19 + 4])
    assert np.array_equal(rec.extra["pac"][7, 2], stored["pac"][7 * 22 : 8 * 22, 2])
    arm = np.deg2rad(stored["arm"][3 * 7 + 1])
    assert np.allclose(rec.extra["robot_joint"][7, 1], arm, atol=1e-5)


@pytest.mark.filterwarnings("ignore")
def test_a_missing_value_is_named_as_the_page_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(blocks("python")[1], {})
    content = dict(np.load("log_2.npz"))
    np.savez("log_2.npz", **{**content, "pac": content["pac"][:-1]})
    assert run(blocks("sh")[0]) == 1
    out, error = capsys.readouterr()
    assert "2 of 3 grasps are in 'bigs'" in out
    said = re.search(r"`('pac' must have .*?\(10999, 3\)\))`", PAGE, flags=re.DOTALL)
    assert " ".join(said[1].split()).replace("'pac' must", "must").split("(got")[0] in error
    assert "log_2.npz': 'pac' must have" in error
