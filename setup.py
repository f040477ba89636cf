"""Refuse an unsupported Python with the reason; pyproject.toml describes the package."""

import os
import sys

from setuptools import setup

if sys.version_info < (3, 11):  # pip would report a conflict of constraints instead
    sys.exit(
        "sidelong needs Python 3.11 to 3.13; this is Python %d.%d. Install a newer one next to it, for example: "
        "uv python install 3.12 && uv venv --python 3.12" % sys.version_info[:2]
    )
if not os.path.isdir(os.path.join("sidelong", "app")):
    sys.exit(
        "sidelong: this copy has files in place of the links in sidelong/; make them with: "
        "git config core.symlinks true && git checkout -- sidelong"
    )
setup()
