"""Shared set-up of the tests."""

import gc
import os
import signal
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, settings

TESTS = Path(__file__).resolve().parent
sys.path.insert(0, str(TESTS))

# Shells start background jobs with Ctrl-C ignored, which the processes under test would inherit.
signal.signal(signal.SIGINT, signal.default_int_handler)

# No test of a property depends on the speed of the machine.
settings.register_profile("any speed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")

#: Each compiled program takes some 20 memory mappings, of which Linux grants a process 65 530.
MOST_MAPPINGS = 30_000

#: Bytes of compiled programs and references that a process of tests keeps.
MOST_MEMORY = 3 * 2**30

#: Tracing makes many objects and few circles.
SELDOM = 50_000, 20, 100

SLOWEST = (
    *("test_diffrax_solvers", "test_check", "test_method_orders"),
    *("test_sparse", "test_sundials", "test_adaptive", "test_hybrid", "test_sparse_newton"),
    *("test_library_solvers", "test_ali3p"),
    *("test_kernel_counts", "test_cli", "test_alpha_family", "test_reports", "test_every_method"),
    *("test_contact", "test_guard", "test_new", "test_accessibility", "test_symplectic"),
    *("test_browser", "test_stability_spectra", "test_tolerances"),
)

QUICKLY_COMPILED = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_parallel_codegen_split_count=1"
)


def pytest_configure(config: pytest.Config) -> None:
    """Compile for the tests before JAX is loaded; processes that tests start inherit this.

    Programs are kept between runs in a cache of the tests' own. They are compiled quickly and run
    slowly, except in benchmarks. Settings of the user win.
    """
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(TESTS.parent / ".cache" / "jax"))
    if "XLA_FLAGS" in os.environ or config.getoption("--benchmark-only"):
        return
    from problems.base import runtime  # noqa: F401  it sets the flags of the project

    os.environ["XLA_FLAGS"] += f" {QUICKLY_COMPILED}"


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage while tests are read, and seldom later: it took a sixth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(*SELDOM)
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that parallel processes end together."""
    places = {name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Forget the compiled programs in time: a process without mappings ends with a segmentation
    fault, and long tests fill the memory. Until then test modules share them."""
    yield
    process = Path("/proc/self")
    if "jax" in sys.modules and process.exists():
        pages = int((process / "statm").read_text().split()[1])
        with (process / "maps").open() as lines:
            mappings = sum(1 for _ in lines)
        if mappings > MOST_MAPPINGS or pages * os.sysconf("SC_PAGE_SIZE") > MOST_MEMORY:
            from helpers import forget_programs

            forget_programs()
            sys.modules["jax"].clear_caches()
            gc.collect()


@pytest.fixture(scope="module")
def worker():
    """A worker in this process, which keeps what the tests of a module make."""
    from bench.plugins.registry import Registry
    from bench.running.worker import Worker

    return Worker(Registry())


@pytest.fixture
def stepbench():
    """Run a command line in this process; returns click's result."""
    from bench.commands.main import main

    def call(*arguments: object) -> Result:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    return call


@pytest.fixture
def refused(stepbench):
    """Run a command line that is refused; returns what it says, in one line."""

    def call(*arguments: object) -> str:
        result = stepbench(*arguments)
        assert result.exit_code != 0, result.output
        assert isinstance(result.exception, SystemExit), repr(result.exception)
        assert "Traceback" not in result.output
        return " ".join(result.output.split())

    return call


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder of one of everything with its pages, to be read alone."""
    from planted import everything, plant
    from small_stores import A_SHOWN_EXPERIMENT

    from bench.results.store import Store
    from reports.pages.html_report import write_html_report

    folder = plant(tmp_path_factory.mktemp("site"), everything())
    with Store(folder, create=True) as store:
        store.keep(A_SHOWN_EXPERIMENT)
    write_html_report(folder)
    return folder


@pytest.fixture(scope="session")
def _chromium(tmp_path_factory: pytest.TempPathFactory):
    from chromium import CHROMIUM, DRIVER, chromium

    if not (CHROMIUM and DRIVER):
        pytest.skip("Chromium and its driver are not installed")
    # Block all requests except those for files and for data in the page.
    flags = "disable-background-networking", "host-resolver-rules=MAP * ~NOTFOUND"
    kept = {"download.default_directory": str(tmp_path_factory.mktemp("downloads"))}
    with chromium(*flags, logs=("browser", "performance"), **kept) as driver:
        driver.downloads = Path(kept["download.default_directory"])
        yield driver


@pytest.fixture
def browser(_chromium):
    """A new tab of the one browser of all tests: no question is known, no complaint is left."""
    first = _chromium.current_window_handle
    _chromium.switch_to.new_window("tab")
    for log in ("browser", "performance"):
        _chromium.get_log(log)
    yield _chromium
    complaints = [entry["message"] for entry in _chromium.get_log("browser")]
    _chromium.close()
    _chromium.switch_to.window(first)
    assert complaints == []


@pytest.fixture(scope="session")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the examples of the documents."""
    from test_contributing import EXAMPLES

    folder = tmp_path_factory.mktemp("examples")
    for name, code in EXAMPLES.items():
        (folder / name).write_text(code)
    return folder


@pytest.fixture
def without_processes(monkeypatch):
    """Do jobs of commands in this process, and take no times; where no process is the point."""
    from bench.running import inventory, worker
    from bench.running.process import NoAnswer
    from bench.running.runner import Runner
    from problems.base.spec import SpecError
    from problems.base.text import said

    def run_here(self, groups, offers=list):
        for task in (task for group in groups for task in group):
            self.progress.working(task.label)
            try:
                state = worker.start_worker(lambda phase, words: None, task.sources)
                yield task, task.job(state, *task.arguments)
            except SpecError as error:
                yield task, NoAnswer("crashed", f"{said(error)}.", refused=True)

    monkeypatch.setattr(Runner, "run", run_here)
    monkeypatch.setattr(Runner, "time", lambda self, tasks, samples, have: iter(()))
    monkeypatch.setattr(worker, "use_one_thread", lambda: None)
    # In this process tests patch functions: what is made here must not be kept.
    monkeypatch.setattr(inventory, "keep_references", lambda file_of: None)
