import signal
from pathlib import Path

import pytest
from hypothesis import settings

PROJECT = Path(__file__).resolve().parents[1]

# How long an example takes is the machine's affair, and decides no test.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

# A shell starts what runs in the background with interrupts ignored, and all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


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
