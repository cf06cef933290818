# SPDX-License-Identifier: Apache-2.0
# airy_pb2.pyi - the generated module makes its classes at run time, from their descriptors: their types are not said.
from typing import Any

def __getattr__(name: str) -> Any: ...
