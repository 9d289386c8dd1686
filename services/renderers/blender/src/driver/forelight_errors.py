"""Errors that the other side knows."""


class Refused(Exception):
    """A question that cannot be answered, with the kind of its error."""

    def __init__(self, kind, message):
        super().__init__(message)
        self.kind = kind
