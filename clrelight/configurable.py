"""Frozen dataclasses whose fields are options: to a JSON object and back, with a wrong name told by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, ClassVar, Self

from clrelight.errors import InputError


class Configurable:
    """What codecs and fits share; subclasses are frozen dataclasses.

    Attributes
    ----------
    id : str
        Name in a registry.
    kind : str
        What messages call such a thing.
    """

    id: ClassVar[str]
    kind: ClassVar[str]

    def to_config(self) -> dict[str, Any]:
        """Return the options as a JSON object; `from_config` takes it back."""
        return asdict(self)  # type: ignore[call-overload]

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Self:
        """Make one from its options; InputError names an option that it does not have."""
        known = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        for key in config:
            if key not in known:
                raise InputError(f"{cls.kind} {cls.id} has no option {key!r}; it has: {', '.join(known) or 'none'}")
        return cls(**config)
