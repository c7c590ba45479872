from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def cases() -> Path:
    """Real inputs that do not belong to the project; tests that need them skip where they are absent."""
    folder = PROJECT / ".." / "shared" / "cases"
    if not folder.is_dir():
        pytest.skip(f"the folder of real cases {folder} is absent")
    return folder


@pytest.fixture(scope="session")
def scenes() -> Path:
    """The scenes shipped as examples."""
    return PROJECT / "examples" / "scenes"
