import json

import pytest


@pytest.fixture
def write(tmp_path):
    """Writes a text, or JSON, to a file: ``write(text, name)``."""

    def write(text, name="hand.urdf"):
        path = tmp_path / name
        path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
        return path

    return write
