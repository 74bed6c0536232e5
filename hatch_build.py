"""Build hook: a wheel brings the kernels' machine code along, where it is compiled, and says for which Python it is."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledKernels(BuildHookInterface):
    """Adds what ``python -m drake_hand.compiled`` left beside the source."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before a wheel is put together; an editable one leaves everything in its place."""
        code = sorted(Path(self.root, "drake_hand").rglob("__pycache__/*.nb[ci]"))
        if version == "editable" or not code:
            return
        build_data["pure_python"], build_data["infer_tag"] = False, True
        build_data["force_include"] |= {str(file): str(file.relative_to(self.root)) for file in code}
