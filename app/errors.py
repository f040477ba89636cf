"""Errors a person can do something about; the command line prints each as one sentence."""

from __future__ import annotations


class InputError(Exception):
    """What was asked for cannot be done as asked: names the field or file and the way out. Exit code 2."""


class FlightError(Exception):
    """The flight could not go on: says what happened and what the vehicle does now. Exit code 1."""


class Interrupted(Exception):
    """A signal has ended the work: says which, and what the vehicle does now. Exit code 130."""
