"""The wall around native libraries: what they raise is ours, what they print is gone."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import cv2
import numpy as np
import pytest

from capture_app.common.errors import ExitCode, NotAvailableError
from reconstruction.common.native_libraries import (
    ForeignError,
    GuardedModule,
    foreign_calls,
    opencv_calls,
    unexpected_error,
)


def _library() -> ModuleType:
    module, inner = ModuleType("library"), ModuleType("library.inner")

    def global_mapping(text: str) -> str:
        os.write(1, b"chatter")
        os.write(2, b"more chatter")
        if text:
            raise RuntimeError(text)
        return "model"

    module.global_mapping = global_mapping  # type: ignore[attr-defined]
    inner.read = global_mapping  # type: ignore[attr-defined]
    module.inner = inner  # type: ignore[attr-defined]
    module.Model = dict  # type: ignore[attr-defined]
    return module


def test_what_a_library_raises_is_an_error_of_ours_on_one_line() -> None:
    library = GuardedModule(_library(), "COLMAP")
    assert library.global_mapping("") == "model"
    with pytest.raises(ForeignError, match=r"COLMAP failed at global mapping: Check failed: \[rig.cc:399\]$"):
        library.global_mapping("Check failed:\n   [rig.cc:399]")
    with pytest.raises(ForeignError, match="COLMAP failed at global mapping: no file"):
        library.inner.read("no file")
    assert library.Model is dict
    assert ForeignError.exit_code == ExitCode.BAD_INPUT


def test_what_a_library_prints_is_gone_and_what_we_print_is_not(capfd: pytest.CaptureFixture[str]) -> None:
    library = GuardedModule(_library(), "COLMAP")
    print("before")
    with foreign_calls("COLMAP", "a test"):
        library.global_mapping("")
        os.write(1, b"chatter")
    print("after")
    assert capfd.readouterr() == ("before\nafter\n", "")


def test_our_own_errors_and_those_of_the_disk_pass() -> None:
    for error in (NotAvailableError("not here"), OSError("disk full")):
        with pytest.raises(type(error)), foreign_calls("COLMAP", "a test"):
            raise error
    with pytest.raises(ValueError, match="ours"), opencv_calls("depth"):
        raise ValueError("ours")
    with pytest.raises(ForeignError, match="OpenCV failed at depth: resize"), opencv_calls("depth"):
        cv2.resize(np.zeros((0, 0), np.uint8), (2, 2))
    silent = pytest.raises(ForeignError, match="COLMAP failed at a test: RuntimeError")
    with silent, foreign_calls("COLMAP", "a test"):
        raise RuntimeError


def test_an_unforeseen_error_says_where_it_comes_from() -> None:
    @contextmanager
    def caught() -> Iterator[list[str]]:
        lines: list[str] = []
        try:
            yield lines
        except Exception as error:
            lines.append(str(unexpected_error(error)))

    with caught() as lines:
        dict[str, int]()["key"]
    with caught() as more:
        raise MemoryError
    assert "unexpected KeyError in test_foreign_calls.py" in lines[0]
    assert "too little memory" in more[0]
