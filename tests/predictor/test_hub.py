"""Predictors on a hub: the real client, and a server with the paths that it asks for."""

import builtins
import time
from pathlib import Path

import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.predictor import MeasuredScore
from torch_geometric_tactile.predictor._hub import PREDICTOR_FILE, model_card
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import ZScore

X = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(0))
REPO = "user/slip"


def predictor(names=("soft", "hard"), width=5):
    torch.manual_seed(0)
    model = TactileFNN(4, 2, widths=(width,), pools=(1,))
    scaler = ZScore().fit(StaticData(x=X))
    return Predictor(model, grid(2, 2, pitch=0.01), scaler, names, num_channels=3)


@pytest.fixture
def hub(monkeypatch):
    constants = pytest.importorskip("huggingface_hub.constants", reason="needs the extra 'hub'")
    from hub_server import hub_server

    # Settings of the client that it reads from the environment when it is imported.
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.delenv("HF_TOKEN", raising=False)
    with hub_server() as (server, url):
        monkeypatch.setenv("HF_ENDPOINT", url)
        yield server


@pytest.fixture
def cache(tmp_path):
    return {"cache_dir": tmp_path / "cache", "token": False}


@pytest.mark.parametrize("upload_mode", ["regular", "lfs"])
def test_pushed_predictor_has_the_same_probabilities(upload_mode, hub, cache, tmp_path):
    hub.upload_mode = upload_mode
    url = predictor().push_to_hub(REPO, token="hf_owner", commit_message="First")
    assert url.endswith(f"/{REPO}/commit/{2:040x}")
    repo = hub.repositories[REPO]
    assert not repo.private
    assert repo.messages == ["First"]
    assert sorted(repo.branches["main"]) == ["README.md", PREDICTOR_FILE]
    assert any("/lfs/" in line for line in hub.requests) == (upload_mode == "lfs")
    again = Predictor.from_pretrained(REPO, **cache)
    assert again(X).equal(predictor()(X))
    assert again.class_names == ("soft", "hard")
    predictor().save(tmp_path / "a")
    assert repo.branches["main"][PREDICTOR_FILE] == (tmp_path / "a").read_bytes()


def test_second_push_replaces_the_first(hub, cache):
    predictor().push_to_hub(REPO, token="hf_owner")
    Predictor.from_pretrained(REPO, **cache)
    predictor(("a", "b")).push_to_hub(REPO, token="hf_owner")
    assert Predictor.from_pretrained(REPO, **cache).class_names == ("a", "b")
    assert hub.repositories[REPO].messages == ["Upload predictor"] * 2


def test_revision_is_a_branch(hub, cache):
    predictor().push_to_hub(REPO, token="hf_owner")
    for _ in range(2):  # creates it, and finds it
        predictor(("a", "b")).push_to_hub(REPO, token="hf_owner", revision="next")
    assert Predictor.from_pretrained(REPO, **cache).class_names == ("soft", "hard")
    assert Predictor.from_pretrained(REPO, revision="next", **cache).class_names == ("a", "b")
    with pytest.raises(FileNotFoundError, match=r"'user/slip' at http.* no revision 'gone'"):
        Predictor.from_pretrained(REPO, revision="gone", **cache)


def test_repository_without_a_namespace_is_of_the_account(hub, cache):
    predictor().push_to_hub("slip", token="hf_owner")
    assert list(hub.repositories) == [REPO]
    assert 'from_pretrained("user/slip")' in hub.repositories[REPO].branches["main"][
        "README.md"
    ].decode("utf-8")


def test_private_repository_needs_a_token(hub, cache):
    predictor().push_to_hub(REPO, token="hf_owner", private=True)
    assert hub.repositories[REPO].private
    match = r"no repository 'user/slip' at http.*, or it is private: .* 'token' that may read it"
    for token in (False, "hf_other"):
        with pytest.raises(FileNotFoundError, match=match):
            Predictor.from_pretrained(REPO, **{**cache, "token": token})
    again = Predictor.from_pretrained(REPO, **{**cache, "token": "hf_owner"})
    assert again(X).equal(predictor()(X))


def test_push_without_the_right_to_write(hub):
    predictor().push_to_hub(REPO, token="hf_owner")
    for token in ("hf_other", False):
        with pytest.raises(PermissionError, match=r"'user/slip' .* 'token' that .* for a push"):
            predictor().push_to_hub(REPO, token=token)
    with pytest.raises(PermissionError, match=r"'user/new' .* 'token' that .* for a push"):
        predictor().push_to_hub("user/new", token="hf_writer")
    assert len(hub.repositories[REPO].messages) == 1
    predictor(("a", "b")).push_to_hub(REPO, token="hf_writer")
    assert len(hub.repositories[REPO].messages) == 2


def test_missing_repository_and_missing_file(hub, cache):
    with pytest.raises(FileNotFoundError, match=r"no repository 'user/gone' at http"):
        Predictor.from_pretrained("user/gone", **cache)
    predictor().push_to_hub(REPO, token="hf_owner")
    del hub.repositories[REPO].branches["main"][PREDICTOR_FILE]
    match = r"'user/slip' .* has no file 'model\.predictor': upload it with Predictor\.push_to_hub"
    with pytest.raises(FileNotFoundError, match=match):
        Predictor.from_pretrained(REPO, **cache)


def test_without_a_network_the_cache_is_used(hub, cache, monkeypatch):
    predictor().push_to_hub(REPO, token="hf_owner")
    with pytest.raises(FileNotFoundError, match=r"'user/slip' .* not in the cache: download it"):
        Predictor.from_pretrained(REPO, local_files_only=True, **cache)
    Predictor.from_pretrained(REPO, **cache)
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")  # where nothing listens
    monkeypatch.setattr(time, "sleep", lambda seconds: None)  # between the client's attempts
    hub.requests.clear()
    for options in ({}, {"local_files_only": True}):
        assert Predictor.from_pretrained(REPO, **options, **cache)(X).equal(predictor()(X))
    assert not hub.requests
    match = r"'user/other' at http.* cannot be reached and is not in the cache: check the connect"
    with pytest.raises(ConnectionError, match=match):
        Predictor.from_pretrained("user/other", **cache)
    with pytest.raises(ConnectionError, match=r"'user/slip' .* cannot be reached"):
        Predictor.from_pretrained(REPO, force_download=True, **cache)
    with pytest.raises(ConnectionError, match=r"'user/slip' .* cannot be reached"):
        predictor().push_to_hub(REPO, token="hf_owner")


@pytest.mark.parametrize("damage", ["flipped", "truncated", "other"])
def test_damaged_file_is_refused(damage, hub, cache):
    predictor().push_to_hub(REPO, token="hf_owner")
    files = hub.repositories[REPO].branches["main"]
    data = files[PREDICTOR_FILE]
    files[PREDICTOR_FILE] = {
        "flipped": data[:-5] + bytes([data[-5] ^ 1]) + data[-4:],
        "truncated": data[: len(data) // 2],
        "other": b"import os",
    }[damage]
    with pytest.raises(ValueError, match=r"model\.predictor' cannot be read as a predictor"):
        Predictor.from_pretrained(REPO, **cache)
    files[PREDICTOR_FILE] = data
    hub.repositories[REPO].commits["main"] = f"{9:040x}"
    assert Predictor.from_pretrained(REPO, **cache)(X).equal(predictor()(X))


def test_model_of_the_user_is_given_again(hub, cache):
    own = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(12, 2))

    class Own(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.layers = own

        def forward(self, x, edge_index):
            return self.layers(x)

    given = Predictor(Own(), grid(2, 2, pitch=0.01), num_channels=3)
    given.push_to_hub(REPO, token="hf_owner")
    with pytest.raises(ValueError, match=r"'model' must be given: .* 'Own' cannot be built"):
        Predictor.from_pretrained(REPO, **cache)
    assert Predictor.from_pretrained(REPO, model=Own(), **cache)(X).equal(given(X))


def test_local_folder_and_file_need_no_client(tmp_path, monkeypatch):
    forbid_import(monkeypatch)
    with pytest.raises(FileNotFoundError, match=r"no 'model\.predictor' in the folder"):
        Predictor.from_pretrained(tmp_path)
    predictor().save(tmp_path / PREDICTOR_FILE)
    for path in (tmp_path, str(tmp_path), tmp_path / PREDICTOR_FILE):
        assert Predictor.from_pretrained(path)(X).equal(predictor()(X))
    with pytest.raises(FileNotFoundError, match=r"there is no predictor or checkpoint '.*gone"):
        Predictor.from_pretrained(tmp_path / "gone")


def forbid_import(monkeypatch):
    plain_import = builtins.__import__

    def checked_import(name, *arguments, **options):
        if name.partition(".")[0] == "huggingface_hub":
            raise ImportError(f"No module named '{name}'")
        return plain_import(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", checked_import)


def test_missing_client_is_an_error_with_its_extra(monkeypatch):
    forbid_import(monkeypatch)
    for call in (predictor().push_to_hub, Predictor.from_pretrained):
        with pytest.raises(ImportError, match=r'pip install "torch-geometric-tactile\[hub\]"'):
            call(REPO)


def test_name_that_is_no_repository(hub, cache):
    for name in ("runs/a/model.predictor", "a b", "../slip"):
        with pytest.raises(ValueError, match=r"no file or folder .* such as 'user/slip'"):
            Predictor.from_pretrained(name, **cache)
    assert not hub.requests


def test_model_card_says_what_the_predictor_is():
    found = predictor(("so|ft", "ha\nrd"))
    found.score = MeasuredScore("fnn", "accuracy", 0.91, 0.02, 5, "5 folds by trial", "all")
    card = model_card(found, REPO)
    assert card.startswith("---\nlibrary_name: torch-geometric-tactile\n")
    for line in (
        "# slip",
        "| task | multiclass |",
        r"| classes | so\|ft, ha\nrd |",
        "| sensor | layout grid_2x2, 4 taxels with 3 channels |",
        "| model | TactileFNN |",
        "| score | fnn: accuracy 0.91 ± 0.02 over 5 splits (5 folds by trial); trained on all |",
        'predictor = Predictor.from_pretrained("user/slip")',
    ):
        assert line in card.splitlines()


def test_model_card_without_classes_and_score():
    model = TactileFNN(4, 1, widths=(5,), pools=(1,))
    card = model_card(Predictor(model, grid(2, 2, pitch=0.01), task="regression"), REPO)
    assert "| task | regression |" in card
    assert "| sensor | layout grid_2x2, 4 taxels |" in card
    assert "classes" not in card
    assert "score" not in card


def test_push_leaves_nothing_behind(hub, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    predictor().push_to_hub(REPO, token="hf_owner")
    assert not list(Path(tmp_path).iterdir())
