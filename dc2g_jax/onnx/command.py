"""Write a trained network as an ONNX file: `dc2g export FOLDER --out network.onnx`."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from dc2g_jax.commands import CommandOptions
from dc2g_jax.estimation import load_network
from dc2g_jax.runtime import InputError


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Write a compact network as an ONNX file, for programs in other languages.

    Attributes:
      network: folder of a trained network, or hf://owner/name; the shipped one by default.
      out: file to write.
    """

    network: Annotated[
        tyro.conf.Positional[str | Path | None], tyro.conf.arg(metavar="[FOLDER]", help_behavior_hint="")
    ] = None
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("network.onnx")


def main(options: Options) -> None:
    """Write the file."""
    if options.out.exists():
        raise InputError(f"{options.out}: exists already; give --out another file")
    from dc2g_jax.onnx import export_onnx  # needs the extra `onnx`

    export_onnx(load_network(options.network), options.out)
    print(f"Written to {options.out}, {options.out.stat().st_size / 1e6:.1f} MB")
