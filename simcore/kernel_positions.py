"""Where in a kernel's source Taichi is while it reads it, told short."""

from __future__ import annotations

import sys
from typing import Any


def tell_positions_short() -> None:
    """Leave Taichi's wrapped drawing of the source line out of what it notes at each of thousands of expressions.

    Drawing takes a third of what the kernels cost a process that finds them compiled. File, line, function and the line
    itself are still told of an error. Versions of Taichi that note positions in another way are left as they are.
    """
    context: Any = getattr(sys.modules.get("taichi.lang.ast.ast_transformer_utils"), "ASTTransformerContext", None)
    if hasattr(context, "get_pos_info"):
        context.get_pos_info = _position


def _position(self: Any, node: Any) -> str:
    place = f'File "{self.file}", line {node.lineno + self.lineno_offset}, in {self.func.func.__name__}:\n'
    return f"{place}{self.src[node.lineno - 1].rstrip()}\n"
