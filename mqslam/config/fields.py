"""Fields of settings, of two kinds: those that users tune, and those that only an expert would touch."""

from __future__ import annotations

from typing import Any

from pydantic import Field
from pydantic.fields import FieldInfo

_EXPERT = {"expert": True}


def expert(default: Any, *, description: str, **bounds: Any) -> Any:
    """Returns a field for a setting that only an expert would touch; it is shown on request only.

    Args:
        default: the value if no file names the setting.
        description: what the setting is, with its unit and reason.
        bounds: bounds as pydantic's `Field` takes them, such as `gt=0.0`.
    """
    return Field(default, description=description, json_schema_extra=dict(_EXPERT), **bounds)


def is_expert(field: FieldInfo) -> bool:
    """Returns whether only an expert would touch a setting."""
    extra = field.json_schema_extra
    return isinstance(extra, dict) and extra.get("expert") is True
