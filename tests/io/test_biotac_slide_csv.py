import pytest
from published_files import SLIDE_COLUMNS, slide, write_csv

from torch_geometric_tactile.io import read_biotac_slide_csv


def test_slide_by_hand(tmp_path):
    rec = read_biotac_slide_csv(slide(tmp_path / "a.csv", frames=3, base=1000))
    assert rec.tactile.shape == (3, 19, 1)
    assert rec.tactile[2, :, 0].tolist() == [*range(2, 21)]
    assert rec.time == pytest.approx([1581073084.690542, 1581073084.700542, 1581073084.710542])
    assert rec.extra["pac"].tolist() == [[*range(1000, 1022)]] * 3
    assert {key: rec.extra[key].tolist() for key in ("tdc", "tac", "pdc")} == {
        "tdc": [3, 3, 3],
        "tac": [100, 101, 102],
        "pdc": [91, 91, 91],
    }
    assert rec.meta == {"sensor": "biotac", "unit": "count"}


def test_lines_without_the_last_comma_and_columns_in_another_order(tmp_path):
    rows = [[f"{t}.5", *range(44)] for t in range(2)]
    path = write_csv(tmp_path / "a.csv", SLIDE_COLUMNS[::-1], [row[::-1] for row in rows])
    rec = read_biotac_slide_csv(path)
    assert rec.time.tolist() == [0.5, 1.5]
    assert rec.tactile[0, 18, 0] == 43


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("ele19", "ele20"), r"the column 'ele19' \(1 of 45 columns"),
        (lambda text: text.replace("22,\n", "22,7\n"), r"line 6 must have 45 cells \(got 46\)"),
        (
            lambda text: text.replace("1581073084.71", "1581073084.69"),
            r"line 4: 'timestamp' must increase",
        ),
    ],
)
def test_refused(tmp_path, change, message):
    path = slide(tmp_path / "mat1_1_bio.csv")
    path.write_text(change(path.read_text()))
    with pytest.raises(ValueError, match=rf"mat1_1_bio.csv'.*{message}"):
        read_biotac_slide_csv(path)
