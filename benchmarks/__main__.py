"""All that is measured: `python benchmarks NAME [options]`; each NAME has its own `--help`."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
TESTS = HERE.parent / "tests"  # whose exact answers benchmarks share


def names() -> list[str]:
    """What can be measured: the modules here that have a `main`."""
    files = [*HERE.glob("*.py"), *HERE.glob("*/command.py")]
    found = [path for path in files if re.search(r"^def main\(", path.read_text(encoding="utf-8"), re.MULTILINE)]
    return sorted(path.stem if path.parent == HERE else path.parent.name for path in found if path.stem != "__main__")


def main() -> None:
    """Run what is named."""
    if len(sys.argv) < 2 or sys.argv[1] not in names():
        sys.exit(f"{__doc__}\n\n  {'  '.join(names())}")
    name = sys.argv.pop(1)
    sys.argv[0] = f"python benchmarks {name}"
    sys.path.insert(1, str(TESTS))
    sys.exit(importlib.import_module(f"{name}.command" if (HERE / name).is_dir() else name).main())


if __name__ == "__main__":
    main()
