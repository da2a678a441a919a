"""The package as installed: its folders, names and light import, and the README's commands."""

import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

import fluidgym
import fluidgym.envs
from fluidgym import _names

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pytest brings it where the standard library has none

ROOT = Path(__file__).resolve().parents[1]
IDS = ["fluidgym/DamBreakContain2D-v0", "fluidgym/DamBreakContain3D-v0"]


def run_python(code: str, *, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run `code` in a fresh interpreter that finds what this one finds, with `path` before it."""
    entries = [str(path)] if path else []
    entries.append(str(Path(fluidgym.__file__).resolve().parents[1]))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entries)}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
    )


def readme_block(marker: str) -> str:
    """Return the fenced block that follows the line `<!-- marker -->` of the README."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(rf"^<!-- {marker} -->\n+```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 1, f"README.md needs one fenced block after <!-- {marker} -->"
    return blocks[0]


def test_environments_are_the_envs_folder():
    package = Path(fluidgym.__file__).resolve().parent
    in_checkout = package == ROOT / "fluidgym"
    expected = ROOT / "envs" if in_checkout else package / "envs"
    assert Path(fluidgym.envs.__file__).resolve().parent == expected


def test_every_package_of_the_tree_is_listed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    settings = project["tool"]["setuptools"]
    assert settings["package-dir"]["fluidgym.envs"] == "envs"
    found = {
        ".".join(file.parent.relative_to(folder.parent).parts)
        for folder in (ROOT / "fluidgym", ROOT / "envs")
        for file in folder.rglob("__init__.py")
        if "fluidgym/envs/" not in file.relative_to(ROOT).as_posix()
    }
    found = {f"fluidgym.{name}" if name.split(".")[0] == "envs" else name for name in found}
    assert sorted(settings["packages"]) == sorted(found)


@pytest.mark.parametrize("env_id", IDS)
def test_ids_are_registered_by_string(env_id):
    spec = gymnasium.registry[env_id]
    assert isinstance(spec.entry_point, str)
    assert isinstance(spec.vector_entry_point, str)
    assert spec.entry_point.startswith("fluidgym.envs")
    assert spec.vector_entry_point.startswith("fluidgym.envs")


def test_import_stays_light():
    heavy = ["warp", "fluidgym.solver", "fluidgym.sph"]
    code = f"import sys, fluidgym; print([name for name in {heavy} if name in sys.modules])"
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"


def test_readme_run_command_runs_the_dam_break():
    assert "examples/dam_break.py" in readme_block("run-command")
    assert (ROOT / "examples" / "dam_break.py").is_file()


def test_readme_test_command_runs_pytest_in_its_own_environment():
    command = readme_block("test-command")
    assert "pytest" in command
    assert ".venv" in command  # .ci/run goes on in the environment that the command makes


@pytest.fixture
def other_fluidgym(tmp_path):
    """A folder in which a distribution named `fluidgym` looks installed."""
    info = tmp_path / "fluidgym-0.1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: fluidgym\nVersion: 0.1.2\n")
    return tmp_path


def test_import_name_is_ours_alone():
    _names.check_import_name()


def test_import_fails_beside_the_other_fluidgym(other_fluidgym):
    result = run_python("import fluidgym", path=other_fluidgym)
    assert result.returncode != 0
    message = result.stderr.strip().splitlines()[-1]
    assert message.startswith("ImportError: The distributions fluidgym 0.1.2 and fluidgym-sph")
    assert "pip uninstall fluidgym" in message


def test_name_check_reports_the_other_fluidgym(other_fluidgym, monkeypatch):
    monkeypatch.syspath_prepend(str(other_fluidgym))
    with pytest.raises(ImportError, match="use a fresh environment"):
        _names.check_import_name()
