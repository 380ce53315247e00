"""Results as standard JSON, which knows neither arrays nor numbers that are not finite."""

import json
import math
from typing import Any


def plain(value: Any) -> Any:
    """Turn ``value`` into types that JSON can hold; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def json_text(value: Any) -> str:
    """The text of a JSON file that holds ``value``, without NaN or infinity."""
    return json.dumps(plain(value), indent=1, allow_nan=False) + "\n"
