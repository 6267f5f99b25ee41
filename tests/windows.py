"""Unit tests that Windows skips, each with its reason; they are skipped by name, and fail nowhere else."""

import sys
from pathlib import Path

import pytest

_LINKS = "Windows gives links to administrators only, and Wine follows none"
_DELETED = "Wine shows a deleted file until it is closed"
_RESERVED = "no folder has such a name there"
_SHELL = "a line is split there as shells of POSIX do"
FILES = {
    "session/test_poor_disks.py": "the calls of a POSIX disk fail there",
    "session/writing/test_power_cut.py": "the calls of a POSIX disk are watched there",
    "session/writing/test_kills.py": "Windows cannot fork",
    "session/writing/test_output_folder.py": "a POSIX disk is watched there, and writers are forked",
    "net/machines.py": "machines are network namespaces of Linux",
}
"""By their paths in tests/unit."""
TESTS: dict[str, str] = {
    "test_readers_that_look_for_a_writer_are_none": "locks are names there, which nobody shares",
    "test_a_trash_that_is_a_link_is_left_alone_and_the_reason_is_given": _LINKS,
    "test_paths_out_of_the_session_are_refused": _LINKS,
    "test_a_pipe_in_a_session_keeps_nobody_waiting": "Windows has no pipes in folders",
    "test_a_writer_that_ends_keeps_no_file_open": "/proc lists a process's open files on Linux",
    "test_a_chunk_that_unpacks_to_256_mb_is_refused": "memory is limited by RLIMIT_AS there",
    "test_a_pipe_is_refused_and_not_waited_for": "Windows has no pipes in folders",
    "test_what_is_imported_and_exported_is_for_its_owner_and_group": "rights are lists there",
    "test_a_link_out_of_the_folder_is_followed_and_said": _LINKS,
    "test_a_video_that_a_person_has_deleted_has_no_further_frame": _DELETED,
    "test_equal_lengths_and_rates_are_a_question_and_the_next_command_works": _SHELL,
    "test_the_priority_does_not_add_to_the_parents": "Windows has no niceness",
    "test_a_library_of_the_system_that_is_missing": "it is a library of Linux",
    "test_a_linked_image_is_refused_if_it_is_elsewhere": _LINKS,
    "test_a_path_that_leads_out_of_a_folder_of_plain_files_is_refused[linked.jpg]": _LINKS,
    "test_the_command_takes_labels_everywhere": _SHELL,
    "test_folders_of_any_script_are_cameras_of_these_labels[reserved-NFC]": _RESERVED,
    "test_folders_of_any_script_are_cameras_of_these_labels[reserved-NFD]": _RESERVED,
    "test_a_name_of_no_text_is_a_label_that_can_be_stored": "names are text there",
    "test_an_identity_is_made_once_and_only_its_user_can_read_it": "rights are lists there",
}
"""By the name of the test, with or without its parameters."""


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Ignore the files that Windows cannot run."""
    name = collection_path.as_posix().rpartition("tests/unit/")[2]
    return True if sys.platform == "win32" and name in FILES else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests that Windows cannot run."""
    for item in items:
        reason = TESTS.get(item.name) or TESTS.get(item.name.partition("[")[0])
        if sys.platform == "win32" and reason:
            item.add_marker(pytest.mark.skip(reason=reason))
