"""Studies without their command."""

import contextlib

from sidelong.app.study.settings import Design
from sidelong.app.study.study import ResultStore, Study, on_processes, table_of


def run_study(settings, table=None, jobs=None, progress=lambda _runs: None):
    """Fly one design on this machine and keep nothing; the table is the cached one unless it is given."""
    with contextlib.closing(ResultStore()) as store:
        study = Study([Design(settings)], store)
        study.fly(on_processes(jobs), lambda of: table or table_of(of), 1, progress)
        return study.results()[0]
