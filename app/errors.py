"""Errors a person can do something about; the command line prints each as one sentence."""

from __future__ import annotations

import sys


class InputError(Exception):
    """The request is invalid: the message names the field or file and the remedy. Exit code 2."""


def missing_package(what: str, package: str, otherwise: str = "") -> InputError:
    """Return the error of a feature whose optional package is not installed; otherwise: another way out."""
    way_out = f", or {otherwise}" if otherwise else ""
    return InputError(f"{what} needs the package {package}: run {sys.executable} -m pip install {package}{way_out}.")


class FlightError(Exception):
    """The flight failed: the message gives the reason and what the vehicle does now. Exit code 1."""


class Interrupted(Exception):
    """A signal ended the work: the message names it and what the vehicle does now. Exit code 130."""
