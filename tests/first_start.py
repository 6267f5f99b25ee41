"""Computes in a fresh clone, once and on all processors, what each of pytest's workers would compute."""

import warnings
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path

import pytest
from _pytest.assertion import rewrite
from hypothesis import strategies as st

FEW = 20
"""Fewer new or changed tests than these are compiled where they are imported."""

_config: pytest.Config


def compile_changed_tests(config: pytest.Config) -> None:
    """Compile tests whose asserts are to be rewritten; where many are, this is the first start of all."""
    global _config
    _config = config  # no process can be sent it, but a forked one has it
    tests = Path(__file__).parent
    changed = [path for path in tests.rglob("test_*.py") if has_changed(path)]
    if len(changed) >= FEW:
        with ProcessPoolExecutor(mp_context=get_context("fork")) as pool:
            characters = pool.submit(save_characters)
            list(pool.map(compile_test, changed, chunksize=4))
            characters.result()


def save_characters() -> None:
    """Let Hypothesis save its table of all characters: two seconds, and a warning that it is early."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        st.text().validate()


def compiled(path: Path) -> Path:
    """Where pytest saves the code of a test."""
    return rewrite.get_cache_dir(path) / (path.stem + rewrite.PYC_TAIL)


def has_changed(path: Path) -> bool:
    code = compiled(path)
    return not code.exists() or code.stat().st_mtime < path.stat().st_mtime


def compile_test(path: Path) -> None:
    """Save the code of a test, where that is possible; otherwise pytest says why when it collects it."""
    with suppress(SyntaxError):
        written, code = rewrite._rewrite_test(path, _config)
        if rewrite.try_makedirs(compiled(path).parent):
            rewrite._write_pyc(_config.stash[rewrite.assertstate_key], code, written, compiled(path))
