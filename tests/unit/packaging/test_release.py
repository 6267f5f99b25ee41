"""What is released: one version, all files, and a container's recipe that fits the Makefile's."""

import re
import runpy
import sys
import tomllib
import types
from pathlib import Path
from typing import Any

import pytest
import yaml

import capture_app
from capture_app.common.address import DEFAULT_PORT
from tests.project import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_version_stands_in_one_place() -> None:
    assert "version" in PROJECT["project"]["dynamic"]
    assert PROJECT["tool"]["hatch"]["version"]["path"] == "capture_app/__init__.py"
    written = [
        path
        for path in (*ROOT.glob("*.toml"), *ROOT.glob("*.cff"), *(ROOT / "docs").glob("*.md"))
        if re.search(rf"version\W+{re.escape(capture_app.__version__)}\b", path.read_text())
    ]
    assert written == []


def test_the_package_has_a_command_of_its_own_name() -> None:
    """`uvx` and `pipx run` start the command that is called as the package is."""
    scripts = PROJECT["project"]["scripts"]
    assert scripts[PROJECT["project"]["name"]] == scripts["capture-app"]


def test_the_sdist_has_what_its_own_tests_and_site_need() -> None:
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    for name in included:
        assert list(ROOT.glob(name)), name
    assert {"tests", "docs", "sample_sessions", "Makefile", "mkdocs.yml", "hatch_build.py"} <= {*included}


def test_the_citation_names_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["license"] == PROJECT["project"]["license"]
    paper = citation["preferred-citation"]
    assert (paper["year"], len(paper["authors"])) == (2019, 4)
    assert paper["url"] in (ROOT / "README.md").read_text()


def test_forms_and_workflows_can_be_read() -> None:
    for path in (ROOT / ".github").rglob("*.yml"):
        assert yaml.safe_load(path.read_text())["name"]
    form = (ROOT / ".github" / "ISSUE_TEMPLATE" / "hardware.yml").read_text()
    assert "capture-app doctor --report" in form


LIBRARIES = {*re.findall(r"\.so\.\d+:(\S+)", (ROOT / "Makefile").read_text())}


def test_every_push_and_pull_request_is_tried_on_every_python() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())
    assert {"push", "pull_request"} <= {*workflow[True]}, "YAML reads `on` as true"
    assert workflow["permissions"] == {"contents": "read"}
    ci, unit = workflow["jobs"]["ci"], workflow["jobs"]["unit"]
    named = [
        line.rpartition(" ")[2]
        for line in PROJECT["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", line)
    ]
    first = ci["container"]["image"].removeprefix("python:").removesuffix("-bookworm")
    assert [first, *unit["strategy"]["matrix"]["python"]] == named
    for job, target in ((ci, ".ci/run"), (unit, "make test")):
        assert [step["run"] for step in job["steps"] if "run" in step][-1].endswith(target)
        assert all("@v" in step["uses"] for step in job["steps"] if "uses" in step)


def test_wheels_are_built_for_all_systems_and_tried_on_both_processors() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text())["jobs"]
    assert any(step.get("run", "").endswith("make wheels") for step in jobs["build"]["steps"])
    tried = jobs["try"]["strategy"]["matrix"]
    runners = {*tried["runner"], *(one["runner"] for one in tried["include"])}
    assert {runner.endswith("-arm") for runner in runners} == {True, False}
    named = [line for line in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d+$", line)]
    assert tried["python"] == [line.rpartition(" ")[2] for line in named]


def test_the_container_installs_what_the_makefile_does() -> None:
    """No builder is here to try it with: its steps are checked against what is tried."""
    recipe = (ROOT / "Dockerfile").read_text()
    assert LIBRARIES
    assert set(recipe.split()) >= LIBRARIES
    assert f"EXPOSE {DEFAULT_PORT}/udp {DEFAULT_PORT}/tcp" in recipe
    for source in re.findall(r"^COPY (?!--from)(.+) \S+$", recipe, re.MULTILINE):
        for name in source.split():
            assert (ROOT / name).exists(), name
    assert "USER simulshot" in recipe


def test_a_build_takes_its_compiler_from_pypi_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "hatchling"
    for part in ("", ".builders", ".hooks", ".plugin", ".interface"):
        name += part
        module: Any = types.ModuleType(name)
        module.BuildHookInterface = object
        monkeypatch.setitem(sys.modules, name, module)
    hook = runpy.run_path(str(ROOT / "hatch_build.py"))["CompileKernels"]()
    hook.root = str(ROOT)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("SIMULSHOT_CAPTURE_ONLY", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert hook.dependencies() == ["ziglang"]
    monkeypatch.setenv("SIMULSHOT_CAPTURE_ONLY", "1")
    assert hook.dependencies() == []
    monkeypatch.delenv("SIMULSHOT_CAPTURE_ONLY")
    (tmp_path / "cc").write_text("#!/bin/sh\n")
    (tmp_path / "cc").chmod(0o755)
    assert hook.dependencies() == []
