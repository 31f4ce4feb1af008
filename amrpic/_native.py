"""Becomes the native module of the best instruction set; see `isa`. Its contents are in `_native.pyi`."""

from . import isa

isa.load(__name__)
