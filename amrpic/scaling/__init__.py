"""How runs scale with ranks: what is measured on the ranks there are, and plans and a model of what more would take."""
