"""Pictures and numbers from outside: files, folders, videos and pipes are read, videos written.

Why imageio-ffmpeg for videos: it carries a whole ffmpeg (all codecs) that runs in a process of its
own, both to read and to write, behind two generators.
"""

from __future__ import annotations

import csv
import math
import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from twin.arrays import Floats, Picture, eight_bits
from twin.errors import InputError, MissingCapability, TwinError
from twin.files import LARGEST_PX, picture_of_png

PICTURES = (".png", ".bmp", ".jpg", ".jpeg")
VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")

_NONE = f"the folder holds no pictures ({', '.join(PICTURES)})"

_DECODERS = ("PNG", "BMP", "JPEG")
"""Pillow's decoders that may open a picture. A file's content chooses the decoder, not its name,
and others start programs (EPS: Ghostscript) or are seldom tested."""

_CONTAINERS = "mov,avi,matroska,mpeg,mpegts,mpegvideo,m4v"
"""ffmpeg's demuxers that may open a video: those of `VIDEOS`. Others read lists of further
files."""

_RAW_FORMATS = {"rgb24": 3, "gray8": 1}
"""Raw formats and their bytes per pixel."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A frame, its file name (with the number in a video or a pipe), or the problem with it."""

    name: str
    picture: Picture | None = None
    problem: str = ""

    @classmethod
    def read(
        cls, sources: Sequence[str], stream: IO[bytes], size: str | None, layout: str | None
    ) -> Iterator[Frame]:
        """Return the frames of files, folders and videos in order; ``-``: raw ones from ``stream``.

        Before any is read, raises `InputError` without frames, or where size and format are missing
        or belong to no raw frames, and `MissingCapability` for a video where the extra package is
        not installed.
        """
        if not sources:
            raise InputError(
                "no frames: give pictures, folders of pictures, videos, or - for raw frames from a "
                "pipe"
            )
        if any(Path(source).suffix.lower() in VIDEOS for source in sources):
            VideoWriter.require()
        if "-" in sources:
            if len(sources) > 1:
                raise InputError("- (frames from a pipe) can't be mixed with files")
            return _raw_frames(stream, *_raw_layout(size, layout))
        if size is not None or layout is not None:
            raise InputError(
                "--size and --format belong to raw frames: give - in place of the pictures"
            )
        if not any(os.path.exists(source) for source in sources):
            raise InputError(f"{sources[0]}: there is no such picture, folder or video")
        if not any(not os.path.isdir(source) or _inside(Path(source)) for source in sources):
            raise InputError(f"{sources[0]}: {_NONE}")
        return _of_sources(sources)


def read_picture(path: str | os.PathLike[str]) -> Picture:
    """Read a PNG, BMP or JPEG file as (h, w, 3) or, if grey, (h, w) uint8; uint16 of a PNG of 16
    bits a channel. EXIF's turn follows how a phone was held, not its sensor: it doesn't count.

    Raises an `InputError` where it is damaged, or its pixels are of another kind.
    """
    from PIL import Image, UnidentifiedImageError

    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe would wait
        raise InputError(f"{path}: is no file")
    try:
        with Image.open(path, formats=_DECODERS) as image:
            mode, (width, height) = image.mode, image.size
            if width * height > LARGEST_PX:
                raise InputError(
                    f"{path}: {width}x{height} px are more than {LARGEST_PX:,}: crop it"
                )
            if image.format == "PNG":
                deep = picture_of_png(Path(path).read_bytes())
                if deep is not None:
                    grey = deep.shape[2] < 3
                    return deep[:, :, 0].copy() if grey else np.ascontiguousarray(deep[:, :, :3])
            if mode.startswith(("I", "F")):
                raise InputError(
                    f"{path}: pixels are {mode}: convert them to 8 bits, or 16-bit PNG"
                )
            if mode in ("CMYK", "YCbCr", "LAB", "HSV"):
                raise InputError(
                    f"{path}: its colours are {mode}, must be RGB or grey: convert it first"
                )
            return np.array(image.convert("L" if mode in ("L", "1", "LA") else "RGB"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such picture") from None
    except UnidentifiedImageError:
        raise InputError(
            f"{path}: is no picture that can be read; allowed are PNG, BMP and JPEG"
        ) from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as problem:
        raise InputError(f"{path}: can't be read ({problem})") from None


_LARGEST = 1e6
"""Of a number in a table."""


def read_numbers(
    path: Path, columns: Sequence[str], *, blank: Sequence[str] = (), absent: Sequence[str] = ()
) -> tuple[list[str], Floats]:
    """Read a CSV file about pictures: their file names (column ``frame``) and (q, c) numbers.

    Cells of ``blank`` columns may be empty, ``absent`` columns may be absent: NaN. An `InputError`
    names the line that holds what is no number.
    """
    needed = ["frame", *(name for name in columns if name not in absent)]
    if not path.is_file():
        raise InputError(f"{path}: there is none; it has the columns {', '.join(needed)}")
    names = []
    numbers = []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            there = reader.fieldnames or ()
            if lacking := [name for name in needed if name not in there]:
                raise InputError(
                    f"{path}: lacks the columns {', '.join(lacking)}; its first line must name "
                    f"{','.join(needed)}, with commas between, and numbers have a point"
                )
            for row in reader:
                line = f"{path}, line {reader.line_num}"
                more = "".join(row.pop(None, ()))
                if not more and not any(row.values()):
                    continue  # spreadsheets end tables with such lines
                if more.strip():
                    raise InputError(
                        f"{line}: has more cells than the first line. Numbers have a point, not a "
                        "comma; quote a text that holds commas"
                    )
                names.append((row["frame"] or "").strip())
                if not names[-1]:
                    raise InputError(f"{line}: frame is empty; give the picture's file name")
                numbers.append(
                    [
                        _number(line, name, row[name], may_be_empty=name in blank)
                        if name in there
                        else math.nan
                        for name in columns
                    ]
                )
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise InputError(f"{path}: can't be read ({problem})") from None
    if not names:
        raise InputError(f"{path}: holds no frames")
    return names, np.array(numbers)


def _number(line: str, key: str, text: str | None, *, may_be_empty: bool) -> float:
    if may_be_empty and not (text or "").strip():
        return math.nan
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    least = 0.0 if key.endswith("_s") else -_LARGEST
    if not (text or "").strip():
        raise InputError(f"{line}: {key} is missing")
    if not least <= value <= _LARGEST:
        unit = key.rsplit("_", 1)[1].replace("n", "N")
        raise InputError(
            f"{line}: {key} = {text!r} must be a finite number, {unit}, from {least:g} to "
            f"{_LARGEST:g}"
        )
    return value


def _of_sources(sources: Sequence[str]) -> Iterator[Frame]:
    for source in sources:
        path = Path(source)
        if not path.is_dir():
            yield from _of_file(path)
            continue
        inside = _inside(path)
        if not inside:
            yield Frame(name=source, problem=_NONE)
        for file in inside:
            yield from _of_file(file)


def _inside(folder: Path) -> list[Path]:
    """Return a folder's pictures and videos in order."""
    files = [each for each in folder.iterdir() if each.suffix.lower() in (*PICTURES, *VIDEOS)]
    return sorted(files, key=_in_number)


def _in_number(path: Path) -> tuple[tuple[str, int], ...]:
    """Return a key that sorts frame_9.png before frame_10.png."""
    return tuple((text, int(digits or -1)) for text, digits in re.findall(r"(\D*)(\d*)", path.name))


def _of_file(path: Path) -> Iterator[Frame]:
    if path.suffix.lower() in VIDEOS:
        yield from _video_frames(path)
        return
    try:
        yield Frame(name=path.name, picture=read_picture(path))
    except InputError as problem:
        yield Frame(name=path.name, problem=str(problem).removeprefix(f"{path}: "))


def _raw_layout(size: str | None, layout: str | None) -> tuple[int, int, int]:
    """Return (width, height, bytes per pixel) of ``WxH`` and a format's name."""
    if size is None or layout is None:
        raise InputError(
            "frames from a pipe need --size WxH and --format rgb24 or gray8, such as --size 640x480"
        )
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    width, height = (int(v) for v in match.groups()) if match else (0, 0)
    if not width or not height or width * height > LARGEST_PX:
        raise InputError(f"--size {size}: must be WIDTHxHEIGHT in px, such as 640x480")
    if layout not in _RAW_FORMATS:
        raise InputError(f"--format {layout}: allowed are {', '.join(_RAW_FORMATS)}")
    return width, height, _RAW_FORMATS[layout]


def _raw_frames(stream: IO[bytes], width: int, height: int, depth: int) -> Iterator[Frame]:
    """Yield frames of raw bytes; a last one that is cut short is a problem."""
    count = width * height * depth
    shape = (height, width, 3) if depth == 3 else (height, width)
    number = 0
    while data := stream.read(count):
        if len(data) < count:
            problem = f"the pipe ended after {len(data)} of {count} bytes of a frame"
            yield Frame(name=str(number), problem=problem)
            return
        yield Frame(name=str(number), picture=np.frombuffer(data, np.uint8).reshape(shape))
        number += 1


def _ffmpeg() -> Any:
    """Return the package that reads and writes videos, or raise `MissingCapability`."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MissingCapability(
            "videos need an extra package: pip install imageio-ffmpeg"
        ) from None
    return imageio_ffmpeg


def _video_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a video file; ffmpeg may open this file alone, and only as a film."""
    package = _ffmpeg()
    if not path.is_file():
        yield Frame(name=path.name, problem="there is no such video")
        return
    try:
        only = ["-protocol_whitelist", "file", "-format_whitelist", _CONTAINERS]
        film = package.read_frames(f"file:{path}", pix_fmt="rgb24", input_params=only)
        with closing(film) as reader:
            width, height = next(reader)["size"]
            for number, data in enumerate(reader):
                picture = np.frombuffer(data, np.uint8).reshape(height, width, 3)
                yield Frame(name=f"{path.name}:{number}", picture=picture)
    except (OSError, RuntimeError, StopIteration, ValueError, KeyError) as problem:
        yield Frame(name=path.name, problem=f"can't be read as a video ({type(problem).__name__})")


class VideoWriter:
    """Writes pictures to a video file as H.264, which has its name only after `close`.

    As a context manager it removes the file if the block fails.

    Parameters
    ----------
    path, size
        The file, and its pictures' width and height; an odd one is made even by a row or column.
    rate
        Frames a second.
    """

    require = staticmethod(_ffmpeg)

    def __init__(self, path: Path, size: tuple[int, int], rate: float = 60.0) -> None:
        self._path = path
        self._part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", str(rate)]
        even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
        h264 = ["-c:v", "libx264", "-crf", "10", "-pix_fmt", "yuv420p", "-v", "error"]
        self._process = subprocess.Popen(
            [_ffmpeg().get_ffmpeg_exe(), "-y", *raw, "-i", "-", *even, *h264, f"file:{self._part}"],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C must not end it before the file is finished
        )

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._process.kill()
            self._process.communicate()
            self._part.unlink(missing_ok=True)

    @classmethod
    def encoded(cls, picture: Picture, path: Path) -> Picture:
        """Return a picture as a video of it alone shows it; ``path`` is written for it, and
        removed."""
        height, width = picture.shape[:2]
        with cls(path, (width, height)) as video:
            video.add(picture)
        (frame,) = _video_frames(path)
        path.unlink()
        if frame.picture is None:
            raise TwinError(f"{path}: {frame.problem}")
        return frame.picture

    def add(self, picture: Picture) -> None:
        """Append a picture, or raise `TwinError`."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(eight_bits(picture)).data)
        except OSError:
            self.close()

    def close(self) -> None:
        """Finish the file, or remove it and raise `TwinError`."""
        if self._process.returncode is not None:
            return
        _, said = self._process.communicate()
        if self._process.returncode == 0:
            os.replace(self._part, self._path)
            return
        self._part.unlink(missing_ok=True)
        why = said.decode(errors="replace").strip().splitlines() or ["ffmpeg ended"]
        raise TwinError(f"{self._path}: the video can't be written ({why[-1]})")
