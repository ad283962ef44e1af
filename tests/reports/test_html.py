import base64
import re

import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.reports import ReportPicture, ReportTable, write_report
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.visualization import plot_layout, save_figure

TABLE = ReportTable("Scores", "of two", ["model", "accuracy"], [["*GCN", "80.0"], ["SVM", "81.0"]])


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "picture.png"
    save_figure(plot_layout(grid(1, 2, pitch=0.002)), path)
    return path


def write(path, **changes):
    arguments = {"title": "T", "notice": "Data: real.", "facts": [], "tables": [], "pictures": []}
    write_report(path, **{**arguments, **changes})
    return path.read_text()


def test_report_begins_with_the_notice(tmp_path):
    page = write(tmp_path / "r.html", notice="Data: GENERATED.", facts=[("Seed", "0")])
    text = re.sub(r"<[^>]*>", "\n", page[page.index("<body") :])
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    assert lines[0] == "Data: GENERATED."
    assert {"Seed", "0"} <= set(lines)


def body_lines(page):
    text = re.sub(r"<[^>]*>", "\n", page[page.index("<body") :])
    return [line.strip() for line in text.splitlines() if line.strip()]


def test_report_of_real_data_begins_with_what_to_conclude(tmp_path):
    page = write(tmp_path / "r.html", verdict="Take the SVM.", is_warning=False)
    assert body_lines(page)[:3] == ["T", "Take the SVM.", "Data: real."]
    assert 'class="warning"' not in page


def test_report_warns_before_it_concludes(tmp_path):
    page = write(tmp_path / "r.html", verdict="Take the SVM.", notice="Data: GENERATED.")
    assert body_lines(page)[:3] == ["Data: GENERATED.", "T", "Take the SVM."]
    assert 'class="warning"' in page


def test_report_holds_its_pictures_and_loads_nothing(tmp_path, picture):
    page = write(tmp_path / "r.html", pictures=[ReportPicture(picture, "Taxels", "two")])
    (data,) = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    assert base64.b64decode(data) == picture.read_bytes()
    assert not re.search("https?:", page)
    assert "<script" not in page


def test_report_draws_starred_rows_bold(tmp_path):
    page = write(tmp_path / "r.html", tables=[TABLE])
    assert "*GCN" not in page
    rows = re.findall(r"<tr([^>]*)>\s*<t[hd][^>]*>\s*(GCN|SVM)", page)
    styles = {name: style for style, name in rows}
    assert styles["GCN"] != styles["SVM"]


def test_report_escapes_its_texts(tmp_path):
    page = write(tmp_path / "r.html", title="<script>alert(1)</script>")
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_report_shows_what_a_screen_would_obey(tmp_path):
    page = write(tmp_path / "r.html", title="a\u202eb\x1b\x9b", notice="Data: a\u2066b")
    assert page.isascii() or not {*page} & {*"\u202e\u2066\x1b\x9b"}
    assert r"<h1>a\u202eb\x1b\x9b</h1>" in page
    assert r"Data: a\u2066b" in page


def test_report_refuses_bad_input_and_keeps_the_old_page(tmp_path):
    path = tmp_path / "r.html"
    before = write(path)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(ValueError, match="'notice' must describe the data"):
        write(path, notice=" ")
    with pytest.raises(ValueError, match="'rows' of table 'Scores' must have 2 cells"):
        write(path, tables=[TABLE._replace(rows=[["GCN"]])])
    with pytest.raises(ValueError, match="must be a PNG file"):
        write(path, pictures=[ReportPicture(tmp_path / "text.png", "", "")])
    with pytest.raises(FileNotFoundError, match=r"none\.png' does not exist"):
        write(path, pictures=[ReportPicture(tmp_path / "none.png", "", "")])
    assert path.read_text() == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["r.html", "text.png"]
