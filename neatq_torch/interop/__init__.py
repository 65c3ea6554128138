"""Networks that travel: out of the library and into it."""

from neatq_torch.interop.c_source import to_c
from neatq_torch.interop.graphs import to_graphviz, to_networkx
from neatq_torch.interop.neat_python import load_neat_python
from neatq_torch.interop.neat_python_config import load_neat_python_config
from neatq_torch.interop.onnx_file import to_onnx
from neatq_torch.interop.opennero import (
    TeamFile,
    TeamFileError,
    read_team_file,
    write_team_file,
)
from neatq_torch.interop.python_source import to_python

__all__ = [
    "TeamFile",
    "TeamFileError",
    "load_neat_python",
    "load_neat_python_config",
    "read_team_file",
    "to_c",
    "to_graphviz",
    "to_networkx",
    "to_onnx",
    "to_python",
    "write_team_file",
]
