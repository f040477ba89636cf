"""What a flight looked like afterwards: its history, figures, and one self-contained page."""

import os

from sidelong.estimators.compiled import FOLDER

os.environ.setdefault("MPLCONFIGDIR", str(FOLDER.parent / "matplotlib"))  # the home may be read-only
