"""Every error that postfx raises on purpose. Each message is one line that names the file, the
plane or the command, and says how to fix it.

    PostfxError                 the command line prints it as ``error: ...`` and exits 2
      FrameError                planes of a frame do not fit together
        GuideError              planes at output size do not fit
      SequenceError             frame pattern or range
        MissingFrameError
      ReadError                 an image file cannot be read
      MissingPlaneError         a pass needs a plane that no file has
      ProfileError              renderer profile
      ColourError               display, view, look-up table, colour space
      DepthError                camera planes and field of view
      DepthOptionError          --depth
      CutError                  --cuts
      StrengthError             --leave
      ExposureError             exposure
      WriteError                an output file cannot be written
        OutputExistsError
        ManifestReadError       a manifest is there but cannot be read now
      RunError                  another run works on the same files
      FarmError                 Ray, or a machine of it, cannot run a chunk
      ManifestError             a manifest is missing or damaged
      CheckpointError           a checkpoint is damaged
      OptionError               options of a command that do not go together
      PassOptionError           option of a pass
      NotCompiledError          a pass was not compiled for this frame
      PassContractError         a pass does not do what it declares
      RegistryError             a pass is unknown or cannot be loaded
      DeviceError               a device is not available
      MemoryBudgetError         --memory
      ModelError                model file
      BindingError              tensor and argument do not fit
      EncodingError             commands in the wrong order
      HazardError               unordered accesses to memory
      CommandError              a command failed while it ran
      CommandTimeout            commands are not done yet
      CaptureError              capture
      CompareError              two captures cannot be compared
      ReportError               report
      BenchError                benchmark
      IntegrationError          helpers for renderers
    Interrupted                 a KeyboardInterrupt: a signal stopped the run
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from postfx.streams import make_printable

LEAST_LIKENESS = 0.65
"""Of a name to a word that may be a misspelt form of it: 1 is the same."""


def find_nearest(word: object, known: Iterable[str], most: int,
                 least: float = LEAST_LIKENESS) -> list[str]:
    """At most so many names that are like a word, whatever their letter case, best first."""
    from difflib import get_close_matches  # on errors only

    folded = {name.lower(): name for name in known}
    return [folded[name] for name in get_close_matches(str(word).lower(), folded, most, least)]


def suggest(word: object, known: Iterable[str]) -> str:
    """': did you mean X?' for a word that is nearly a known one, or begins with one; else
    nothing."""
    names = list(known)
    begins = sorted((name for name in names if name and str(word).lower().startswith(name.lower())),
                    key=len)
    near = find_nearest(word, names, 1) or begins[-1:]
    return f": did you mean {near[0]}?" if near else ""


def offer(word: object, known: Iterable[str], lead: str = "use") -> str:
    """What follows a word that is none of the known ones: ': did you mean B? use A, B', or ': use
    A, B' where it is like none of them."""
    names = list(known)
    return f"{suggest(word, names) or ':'} {lead} {', '.join(names)}"


class PostfxError(Exception):
    """Base of every error that postfx raises on purpose; the command line prints it as
    ``error: ...`` and exits 2. Names of files and layers in its text are printable, as a program
    may show it on a terminal."""

    def __str__(self) -> str:
        return make_printable(super().__str__())

    def __reduce__(self) -> tuple[Any, ...]:
        # The default pickle calls the constructor with the message alone, which fails where it
        # takes more.
        return _unpickle, (type(self), self.args, self.__dict__)


def _unpickle(kind: type[PostfxError], args: tuple[Any, ...],
              attributes: dict[str, Any]) -> PostfxError:
    """An error that came from another process."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error


# Frames and files


class FrameError(PostfxError):
    """A frame's planes do not fit together: size, channels or data type."""


class GuideError(FrameError):
    """Planes at output size do not fit the frame or the output: role or size."""


class SequenceError(PostfxError):
    """A frame pattern or frame range cannot be understood, or matches no file."""


class MissingFrameError(SequenceError):
    """A frame of the range has no file."""


class ReadError(PostfxError):
    """A file cannot be read: broken, deep, or of an unknown format."""


class MissingPlaneError(PostfxError):
    """A plane that a pass needs is in none of the frame's files."""


class ProfileError(PostfxError):
    """A renderer profile is unknown, malformed or does not fit the file."""


class ColourError(PostfxError):
    """A display, view, look-up table or colour space is unknown or cannot be had as asked for."""


class DepthError(PostfxError):
    """Near and far planes or a field of view that no camera has."""


class DepthOptionError(PostfxError):
    """What is said about depth cannot be understood."""


class CutError(PostfxError):
    """What is said about cuts cannot be understood."""


class StrengthError(PostfxError):
    """What is to be left alone cannot be understood, or is not in the file."""


class ExposureError(PostfxError):
    """The exposure asked for cannot be had."""


# Output and runs


class WriteError(PostfxError):
    """An output file cannot be written."""


class OutputExistsError(WriteError):
    """An output file is already there, and neither overwriting nor skipping was asked for."""


class ManifestReadError(WriteError):
    """A manifest is there but cannot be read now: no permission, or a failing disk. It may well be
    intact."""


class RunError(PostfxError):
    """Another run works on the same files."""


class FarmError(PostfxError):
    """Ray cannot be reached, or a machine that it knows cannot run a chunk."""


class ManifestError(PostfxError):
    """A manifest is missing or cannot be understood."""


class CheckpointError(PostfxError):
    """A checkpoint is damaged, or belongs to something else."""


class Interrupted(KeyboardInterrupt):
    """A signal told a run to stop, and it did.

    Attributes:
        exit_code: 128 plus the signal's number, as in shells: 130 after Ctrl-C, 143 after SIGTERM.
    """

    def __init__(self, signal_number: int) -> None:
        super().__init__("interrupted")
        self.exit_code = 128 + signal_number


# Passes


class OptionError(PostfxError):
    """Options of a command do not go together, or one lacks another that it needs."""


class PassOptionError(PostfxError):
    """A pass was given an option it does not know, or a value it cannot use."""


class NotCompiledError(PostfxError):
    """A pass was asked to encode a frame of a spec it was not compiled for."""


class PassContractError(PostfxError):
    """A pass does not do what it declares: a fault of the pass, not of the frame."""


class RegistryError(PostfxError):
    """A pass is unknown or cannot be loaded."""


# Devices and commands


class DeviceError(PostfxError):
    """A device is not available, or an option does not fit it."""


class MemoryBudgetError(PostfxError):
    """A memory budget cannot be read, or nothing can be done within it."""


class ModelError(PostfxError):
    """A model file is missing, damaged, not the one its card describes, or cannot be
    specialised."""


class BindingError(PostfxError):
    """A tensor does not fit the argument it is bound to, or an argument has no tensor."""


class EncodingError(PostfxError):
    """Commands are recorded, committed or waited for in the wrong order."""


class HazardError(PostfxError):
    """Two accesses to the same memory are not ordered, or memory is read that nothing wrote.

    Attributes:
        kind: 'read after write', 'write after write', 'write after read', 'read before write',
            'aliasing', 'released' or 'host access'.
        tensor: name of the tensor.
        first, second: labels of the commands concerned, earlier one first; `first` is None when
            there is only one.
    """

    def __init__(self, message: str, kind: str, tensor: str, first: str | None,
                 second: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.tensor = tensor
        self.first = first
        self.second = second


class CommandError(PostfxError):
    """A command failed while it ran, or did not run because a failed command lost what it reads.

    The cause is chained: the error that the command raised, or the first command's CommandError.

    Attributes:
        label: the command's label.
    """

    def __init__(self, message: str, label: str) -> None:
        super().__init__(message)
        self.label = label


class CommandTimeout(PostfxError):
    """Commands were not done in time; they go on running and can be waited for again.

    Attributes:
        running: label of the command that is running; None when the next buffer has not begun.
        waiting: labels of the command buffers that wait behind it, in order.
    """

    def __init__(self, message: str, running: str | None, waiting: tuple[str, ...]) -> None:
        super().__init__(message)
        self.running = running
        self.waiting = waiting


class CaptureError(PostfxError):
    """A capture was asked for something it cannot do, or could not keep all that happened."""


# Tools


class CompareError(PostfxError):
    """Two captures cannot be compared: other commands, other tensors, or their content was not
    kept."""


class ReportError(PostfxError):
    """A report cannot be made: references do not fit, a library is missing, or options exclude each
    other."""


class BenchError(PostfxError):
    """A benchmark cannot be made: frames do not fit together, a method is unknown, or a library is
    not installed."""


class IntegrationError(PostfxError):
    """A helper for renderers was given matrices, shapes or words it cannot use."""
