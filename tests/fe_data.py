"""Where files of FE programs lie that are not part of the repository: $HPCRED_SHARED_DATA/fe, or beside a checkout."""

import os
from pathlib import Path

import pytest

_PLACES = [Path(os.environ["HPCRED_SHARED_DATA"])] if "HPCRED_SHARED_DATA" in os.environ else []
_PLACES += [parent / "shared" / "data" for parent in Path(__file__).resolve().parents]
FE = next((place / "fe" for place in _PLACES if (place / "fe").is_dir()), None)

needs_fe = pytest.mark.skipif(FE is None, reason="needs the files of FE programs, see HPCRED_SHARED_DATA")
