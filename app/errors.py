"""Errors a person can do something about; the command line prints each as one sentence."""

from __future__ import annotations

import sys


class InputError(Exception):
    """What was asked for cannot be done as asked: names the field or file and the way out. Exit code 2."""


def missing_package(what: str, package: str, otherwise: str = "") -> InputError:
    """Return the error of a feature whose optional package is not installed.

    Args:
        what: The feature, as the beginning of the sentence.
        package: What pip has to install.
        otherwise: Another way out.

    """
    way_out = f", or {otherwise}" if otherwise else ""
    return InputError(f"{what} needs the package {package}: run {sys.executable} -m pip install {package}{way_out}.")


class FlightError(Exception):
    """The flight could not go on: says what happened and what the vehicle does now. Exit code 1."""


class Interrupted(Exception):
    """A signal has ended the work: says which, and what the vehicle does now. Exit code 130."""
