"""The mesh and what lives on it: domain, boxes, levels of refinement, fields of cell values."""
