import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

PROJECT = Path(__file__).resolve().parents[1]

# The duration of an example decides no test.  'make test' draws the same examples everywhere, 'make fuzz' takes
# --hypothesis-profile=fuzz and a seed.
_UNTIMED = {"deadline": None, "database": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("fixed", derandomize=True, **_UNTIMED)
settings.register_profile("fuzz", derandomize=False, print_blob=True, **_UNTIMED)
settings.load_profile("fixed")

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
