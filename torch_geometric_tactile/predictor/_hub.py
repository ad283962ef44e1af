r"""Upload and download of predictors to and from repositories of the Hugging Face Hub."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile._texts import printable
from torch_geometric_tactile._typing import PathLike

if TYPE_CHECKING:
    from torch_geometric_tactile.predictor.predictor import Predictor

#: The name of a predictor's file in a repository or a folder.
PREDICTOR_FILE = "model.predictor"
_CARD_TEMPLATE = """---
library_name: torch-geometric-tactile
tags:
- tactile
- robotics
---

# {name}

A predictor for readings of a tactile sensor.

{table}

```python
from torch_geometric_tactile import Predictor

predictor = Predictor.from_pretrained("{repo_id}")
probabilities = predictor(reading)
```
"""


def push_predictor(
    predictor: "Predictor",
    repo_id: str,
    *,
    token: str | bool | None,
    private: bool | None,
    commit_message: str,
    revision: str | None,
) -> str:
    r"""Uploads the file of a predictor and its model card, and returns the URL of the commit."""
    api = _hub_client(token)
    from huggingface_hub import CommitOperationAdd

    with TemporaryDirectory() as folder:
        path = Path(folder) / PREDICTOR_FILE
        predictor.save(path)
        with _translated_client_errors(repo_id, api.endpoint, revision):
            # `create_repo` adds the account to a name without one. Tokens that may write to only
            # one repository must not call it if the repository exists.
            if "/" not in repo_id or not api.repo_exists(repo_id):
                repo_id = api.create_repo(repo_id, private=private, exist_ok=True).repo_id
            if revision is not None:
                api.create_branch(repo_id, branch=revision, exist_ok=True)
            card = model_card(predictor, repo_id).encode()
            commit = api.create_commit(
                repo_id,
                [CommitOperationAdd(PREDICTOR_FILE, path), CommitOperationAdd("README.md", card)],
                commit_message=commit_message,
                revision=revision,
            )
    return str(commit.commit_url)


def predictor_file(
    path_or_repo_id: PathLike,
    *,
    revision: str | None,
    token: str | bool | None,
    cache_dir: PathLike | None,
    local_files_only: bool,
    force_download: bool,
) -> Path:
    r"""Returns the path of a predictor's file: a local file, the file in a local folder, or a file
    downloaded from a repository.
    """
    path = Path(path_or_repo_id)
    if path.is_dir():
        path = path / PREDICTOR_FILE
        if not path.is_file():
            raise FileNotFoundError(
                f"there is no '{PREDICTOR_FILE}' in the folder '{path.parent}': write it with "
                "Predictor.save"
            )
        return path
    if path.is_file() or isinstance(path_or_repo_id, os.PathLike):
        return path
    api = _hub_client(token)
    with _translated_client_errors(path_or_repo_id, api.endpoint, revision, local_files_only):
        return Path(
            api.hf_hub_download(
                path_or_repo_id,
                PREDICTOR_FILE,
                revision=revision,
                cache_dir=cache_dir,
                local_files_only=local_files_only,
                force_download=force_download,
            )
        )


def model_card(predictor: "Predictor", repo_id: str) -> str:
    r"""Returns the text of the model card: task, classes, sensor, score and how to load it."""
    layout, channels = predictor.layout, predictor.preparation.num_channels
    sensor = f"layout {layout.name}, {layout.num_taxels} taxels"
    rows = {
        "task": predictor.task,
        "classes": ", ".join(predictor.class_names),
        "sensor": sensor if channels is None else f"{sensor} with {channels} channels",
        "model": type(predictor.model).__name__,
        "score": "" if predictor.score is None else str(predictor.score),
    }
    lines = ["| | |", "|---|---|"]
    lines += [f"| {key} | {_escape_cell(text)} |" for key, text in rows.items() if text]
    return _CARD_TEMPLATE.format(
        name=repo_id.rpartition("/")[2], table="\n".join(lines), repo_id=repo_id
    )


def _escape_cell(text: str) -> str:
    # Otherwise a bar or a line break in a class name would end the cell or its row.
    return printable(text).replace("|", r"\|")


def _hub_client(token: str | bool | None) -> Any:
    try:
        from huggingface_hub import HfApi
    except ImportError as error:
        raise ImportError(
            "sharing predictors needs 'huggingface_hub': "
            'pip install "torch-geometric-tactile[hub]"'
        ) from error
    # `huggingface_hub` reads the variable only when it is imported, which may have been earlier.
    endpoint = os.environ.get("HF_ENDPOINT", "").rstrip("/") or None
    return HfApi(endpoint, token, library_name="torch-geometric-tactile")


@contextmanager
def _translated_client_errors(
    repo_id: str, endpoint: str, revision: str | None, local_files_only: bool = False
) -> Iterator[None]:
    r"""Replaces errors of the client by errors that name the repository and a remedy."""
    from huggingface_hub import errors

    name = f"'{repo_id}' at {endpoint}"
    try:
        yield
    except errors.HFValidationError as error:
        raise ValueError(
            f"there is no file or folder '{repo_id}', and a repository must have a name such as "
            "'user/slip'"
        ) from error
    except errors.GatedRepoError as error:
        raise PermissionError(
            f"{name} has terms of use: accept them on its page, and pass your 'token'"
        ) from error
    except errors.RepositoryNotFoundError as error:
        raise FileNotFoundError(
            f"there is no repository {name}, or it is private: check the name, and pass a 'token' "
            "that may read it"
        ) from error
    except errors.RevisionNotFoundError as error:
        raise FileNotFoundError(f"{name} has no revision '{revision}'") from error
    except errors.RemoteEntryNotFoundError as error:
        raise FileNotFoundError(
            f"{name} has no file '{PREDICTOR_FILE}': upload it with Predictor.push_to_hub"
        ) from error
    except errors.LocalEntryNotFoundError as error:
        if local_files_only:
            raise FileNotFoundError(
                f"{name} is not in the cache: download it once without 'local_files_only'"
            ) from error
        raise ConnectionError(
            f"{name} cannot be reached and is not in the cache: check the connection"
        ) from error
    except errors.HfHubHTTPError as error:
        reason = " ".join(str(error).split())
        if error.response.status_code in (401, 403):
            raise PermissionError(
                f"the token is not accepted for {name}: pass a 'token' that may read it, or write "
                f"to it for a push ({reason})"
            ) from error
        raise OSError(f"{name} returned an error: {reason}") from error
    except (ImportError, OSError):
        raise
    except Exception as error:  # HTTP errors: their package depends on the version of the client
        if isinstance(error, ValueError) and error.__cause__ is None:
            raise
        raise ConnectionError(
            f"{name} cannot be reached: check the connection ({error.__cause__ or error})"
        ) from error
