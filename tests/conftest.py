import signal
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

PROJECT = Path(__file__).resolve().parents[1]

# No test depends on the duration of an example.  'make test' draws equal examples everywhere, 40 unless a test states
# another number; 'make fuzz' uses --hypothesis-profile=fuzz, a seed and 100 examples.
_UNTIMED = {"deadline": None, "database": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("fixed", derandomize=True, max_examples=40, **_UNTIMED)
settings.register_profile("fuzz", derandomize=False, print_blob=True, **_UNTIMED)
settings.load_profile("fixed")

# Background processes of a shell and their children ignore interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the cases of tests with the mark ``quick_cases(n)`` as slow, except `n` evenly spaced ones."""
    cases_of: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("quick_cases"):
            cases_of.setdefault(item.nodeid.split("[")[0], []).append(item)
    for cases in cases_of.values():
        count = cases[0].get_closest_marker("quick_cases").args[0]
        quick = {number * len(cases) // count for number in range(count)}
        for number, item in enumerate(cases):
            if number not in quick:
                item.add_marker("slow")


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep cached results of the tests, and of the processes that they start, apart from those of the user."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RESGRID_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def processes() -> Iterator[Executor]:
    """Two worker processes, started once; a forked process could wait forever for a lock of another thread."""
    import resgrid as rg

    with rg.open_executor("processes:2") as executor:
        yield executor


@pytest.fixture(scope="session")
def cases() -> Path:
    """Real inputs outside the project; tests that need them are skipped without them."""
    folder = PROJECT / ".." / "shared" / "cases"
    if not folder.is_dir():
        pytest.skip(f"the folder of real cases {folder} is absent")
    return folder


@pytest.fixture(scope="session")
def scenes() -> Path:
    """The scenes shipped as examples."""
    return PROJECT / "examples" / "scenes"
