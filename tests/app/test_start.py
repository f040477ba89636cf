import subprocess
import sys


def test_the_command_line_starts_without_what_takes_long_to_load():
    code = "import sys, app.cli; print(*{'numba', 'matplotlib', 'filterpy'}.intersection(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
