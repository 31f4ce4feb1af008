"""The mesh and values on it: domain, boxes, levels of refinement, fields of cell values."""
