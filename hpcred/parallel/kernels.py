"""Choose the kernels of OpenBLAS that `hpcred bench --save` found to be the quickest on this kind of processor.

OpenBLAS reads OPENBLAS_CORETYPE when it is loaded, as with numpy. Therefore this module needs Python alone, and
`import hpcred` calls `take_saved` before anything else.
"""

import errno
import json
import os
import re
import stat
import zlib
from pathlib import Path

CORETYPE = "OPENBLAS_CORETYPE"
TAKEN = "HPCRED_KERNELS"  # what CORETYPE was set to here: jobs on other machines inherit it, and choose for themselves

# kernels, and the flags of a processor that supports them; from old to new
NEEDS = {
    "Prescott": "pni", "Nehalem": "sse4_2", "Sandybridge": "avx", "Zen": "avx2", "Haswell": "avx2",
    "SkylakeX": "avx512bw", "Cooperlake": "avx512_bf16", "SapphireRapids": "amx_bf16",
    "ARMV8": "asimd", "CortexA57": "asimd", "CortexA72": "asimd", "ThunderX2T99": "asimd", "NeoverseN1": "asimddp",
    "ARMV8SVE": "sve", "A64FX": "sve", "NeoverseV1": "sve", "NeoverseN2": "sve2",
}  # fmt: skip
MOST = 2**20  # letters of the file of saved kernels
PROCESSORS = Path("/proc/cpuinfo")


def possible(flags, has) -> list[str]:
    """Return the kernels that a processor with these flags supports, and for which `has(name)`, from new to old."""
    return [name for name, flag in reversed(NEEDS.items()) if flag in flags and has(name)]


def flags() -> set[str]:
    """The flags of the processor, as /proc/cpuinfo lists them; empty elsewhere."""
    return set(re.sub(r"^(?!flags|Features).*|^\w+\s*:", "", _first_processor(), flags=re.MULTILINE).split())


def processor() -> str:
    """The kind of processor by which kernels are saved: its name and a sum of its flags, or else the machine's name."""
    named = re.findall(r"^(?:model name|CPU (?:implementer|part|variant))\s*:\s*(.*)", _first_processor(), re.MULTILINE)
    if not named:
        return f"{os.uname().machine} {os.uname().nodename}"
    return f"{' '.join(named)} {zlib.crc32(' '.join(sorted(flags())).encode()):08x}"


def place() -> Path:
    """The file of saved kernels, in the folder of settings of the user."""
    folder = os.environ.get("XDG_CONFIG_HOME") or os.path.join(os.path.expanduser("~"), ".config")
    return Path(folder, "hpcred", "kernels.json")


def saved() -> dict[str, str]:
    """Saved kernels by kind of processor; of a file that is damaged or cannot be read none."""
    return _read()[0]


def damage() -> str | None:
    """Say why nothing is taken from the file of saved kernels, and what to do; None where it is fine, or not there."""
    wrong = _read()[1]
    return wrong and (
        f"{place()}: {wrong}, so OpenBLAS chooses its kernels; write it anew with `hpcred bench --save`, or remove it "
        "with `hpcred bench --forget`"
    )


def _read():
    """Saved kernels by kind of processor, and what is wrong with the file, or None."""
    try:
        found = json.loads(_text(place()))
    except FileNotFoundError:
        return {}, None
    except OSError as error:
        return {}, f"the saved kernels cannot be read ({error.strerror})"
    except (ValueError, RecursionError):
        return {}, "the file of saved kernels is damaged (no JSON)"
    if not isinstance(found, dict):
        return {}, f"the file of saved kernels is damaged (found {type(found).__name__}, expected a table)"
    known = {kind: name for kind, name in found.items() if isinstance(name, str) and name in NEEDS}
    if (kind := processor()) in found.keys() - known.keys():
        return known, f"the file of saved kernels is damaged (found {str(found[kind])[:40]!r}, expected kernels)"
    return known, None


def _text(path) -> str:
    """The text of a file, which starts every command: a pipe is not waited for, nor is more read than is saved there.
    Raises OSError, ValueError."""
    with open(path, encoding="utf-8", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.ENXIO, "it is a pipe or a device")
        return file.read(MOST)


def take_saved():
    """Have OpenBLAS take the kernels that are saved for this processor, unless the user has named others."""
    inherited = os.environ.pop(TAKEN, None)
    if inherited is not None and inherited == os.environ.get(CORETYPE):
        del os.environ[CORETYPE]
    if CORETYPE not in os.environ and (known := saved()) and (name := known.get(processor())):
        os.environ[CORETYPE] = os.environ[TAKEN] = name


def origin(taken) -> str:
    """Who chose the kernels that OpenBLAS has `taken`."""
    name = os.environ.get(CORETYPE)
    if not name or name.lower() != taken.lower():
        return "OpenBLAS"
    return "hpcred bench --save" if TAKEN in os.environ else CORETYPE


def too_late(made) -> str | None:
    """The hint for an OpenBLAS (see processor.blas) that was loaded before the saved kernels were chosen."""
    name = os.environ.get(TAKEN)
    if name is None or made.lower().endswith(f", {name.lower()}"):
        return None
    return f"{made} is not what `hpcred bench --save` has kept, {name}: in Python, import hpcred before numpy"


def _first_processor():
    """What Linux says of the first processor, as far as the empty line behind it."""
    try:
        with open(PROCESSORS, encoding="utf-8", errors="replace") as file:
            return "".join(iter(file.readline, "\n"))
    except OSError:
        return ""
