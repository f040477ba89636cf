"""What the command line loads, and that each of its commands can be loaded."""

import subprocess
import sys

import pytest

from sidelong.app.cli import COMMANDS, load_command

SLOW = {"numba", "matplotlib", "filterpy", "scipy", "numpy", "pydantic", "mavsdk", "pymavlink", "shapely"}


def loaded(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split()) & SLOW


def test_the_list_of_commands_loads_nothing_slow():
    assert loaded("import sidelong.app.cli") == set()


def test_wrong_options_of_a_launch_are_refused_before_the_link_is_loaded():
    mistaken = "from sidelong.app.cli import app\napp(['launch', '--side', 'up'], standalone_mode=False)"
    assert loaded(f"try:\n    exec({mistaken!r})\nexcept Exception as error:\n    assert 'side' in str(error)") <= {
        "numba",
        "numpy",
        "pydantic",
        "pymavlink",
        "scipy",
    }


def test_check_loads_no_link():
    assert not loaded("import sidelong.app.commands.check") & {"mavsdk", "pymavlink", "matplotlib", "filterpy"}


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_loads(name):
    command = load_command(name)
    assert command.name == name
    assert "For example:" in command.help
