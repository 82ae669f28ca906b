"""The schemas of scenarios and comparisons, made once for all tests that read them."""

from __future__ import annotations

import functools
import json
from typing import Any

from vstestbed.scenario.catalogue import schema_of


@functools.cache
def whole_schema(cls: type) -> dict[str, Any]:
    """JSON Schema of a spec class as its file has it. Call it in no test that adds kinds."""
    return json.loads(json.dumps(schema_of(cls)))
