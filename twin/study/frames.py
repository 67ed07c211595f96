"""Recorded frames as pictures: files, folders, videos, and raw bytes from a pipe, one after the other.

A frame that can't be read comes as its problem, not as an exception, so that a sequence goes on.

Why imageio-ffmpeg for videos: it carries a whole ffmpeg (all codecs) that runs in a process of its own, both to read
and to write, behind two generators.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from twin.arrays import Picture
from twin.errors import InputError, MissingCapability, TwinError

PICTURES = (".png", ".bmp", ".jpg", ".jpeg")
VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg")
FORMATS = {"rgb24": 3, "gray8": 1}
"""Raw formats and their bytes per pixel."""

LARGEST_PX = 50_000_000


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A frame, or why there is none.

    Attributes
    ----------
    name
        File name, with the number in a video; the number in a pipe.
    picture
        (h, w, 3) or (h, w) uint8; None where it can't be read.
    problem
        Why not.
    """

    name: str
    picture: Picture | None = None
    problem: str = ""


def read_picture(path: str | os.PathLike[str]) -> Picture:
    """Read a PNG, BMP or JPEG file of 8 bits a channel as (h, w, 3) or, if grey, (h, w) uint8.

    Raises
    ------
    InputError
        There is none, it is damaged, or its pixels are of another kind.
    """
    from PIL import Image, UnidentifiedImageError

    if os.path.exists(path) and not os.path.isfile(path):  # a pipe would be waited for
        raise InputError(f"{path}: is no file")
    try:
        with Image.open(path) as image:
            if image.width * image.height > LARGEST_PX:
                raise InputError(f"{path}: {image.width}x{image.height} px are more than {LARGEST_PX:,}: crop it")
            if image.mode.startswith(("I", "F")):
                raise InputError(f"{path}: has more than 8 bits a channel ({image.mode}): convert it to 8 bits first")
            if image.mode in ("CMYK", "YCbCr", "LAB", "HSV"):
                raise InputError(f"{path}: its colours are {image.mode}, must be RGB or grey: convert it first")
            grey = image.mode in ("L", "1", "LA")
            return np.array(image.convert("L" if grey else "RGB"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such picture") from None
    except UnidentifiedImageError:
        raise InputError(f"{path}: is no picture that can be read; allowed are PNG, BMP and JPEG") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as problem:
        raise InputError(f"{path}: can't be read ({problem})") from None


def frames(sources: Sequence[str], stream: IO[bytes], size: str | None, layout: str | None) -> Iterator[Frame]:
    """Yield the frames of files, folders and videos, in order; ``-`` is raw frames from ``stream``.

    Raises
    ------
    InputError
        No frames, or ``-`` without its size and format.
    MissingCapability
        A video, and the extra package is not there.
    """
    if not sources:
        raise InputError("no frames: give pictures, folders of pictures, videos, or - for raw frames from a pipe")
    if "-" in sources:
        if len(sources) > 1:
            raise InputError("- (frames from a pipe) can't be mixed with files")
        yield from raw_frames(stream, *raw_layout(size, layout))
        return
    for source in sources:
        path = Path(source)
        if path.is_dir():
            files = sorted((f for f in path.iterdir() if f.suffix.lower() in (*PICTURES, *VIDEOS)), key=in_number)
            if not files:
                yield Frame(name=source, problem=f"the folder holds no pictures ({', '.join(PICTURES)})")
            for file in files:
                yield from _of_file(file)
        else:
            yield from _of_file(path)


def in_number(path: Path) -> tuple[tuple[str, int], ...]:
    """Return a key that sorts files as they were counted: frame_9.png before frame_10.png, whatever the zeros."""
    return tuple((text, int(digits or -1)) for text, digits in re.findall(r"(\D*)(\d*)", path.name))


def _of_file(path: Path) -> Iterator[Frame]:
    if path.suffix.lower() in VIDEOS:
        yield from video_frames(path)
        return
    try:
        yield Frame(name=path.name, picture=read_picture(path))
    except InputError as problem:
        yield Frame(name=path.name, problem=str(problem).removeprefix(f"{path}: "))


def raw_layout(size: str | None, layout: str | None) -> tuple[int, int, int]:
    """Return (width, height, bytes per pixel) of ``WxH`` and a format's name."""
    if size is None or layout is None:
        raise InputError("frames from a pipe need --size WxH and --format rgb24 or gray8, such as --size 640x480")
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    width, height = (int(v) for v in match.groups()) if match else (0, 0)
    if not width or not height or width * height > LARGEST_PX:
        raise InputError(f"--size {size}: must be WIDTHxHEIGHT in px, such as 640x480")
    if layout not in FORMATS:
        raise InputError(f"--format {layout}: allowed are {', '.join(FORMATS)}")
    return width, height, FORMATS[layout]


def raw_frames(stream: IO[bytes], width: int, height: int, depth: int) -> Iterator[Frame]:
    """Yield frames of raw bytes; a last one that is cut short is a problem."""
    count, number = width * height * depth, 0
    while True:
        data = stream.read(count)
        if not data:
            return
        if len(data) < count:
            yield Frame(name=str(number), problem=f"the pipe ended after {len(data)} of {count} bytes of a frame")
            return
        shape = (height, width, 3) if depth == 3 else (height, width)
        yield Frame(name=str(number), picture=np.frombuffer(data, np.uint8).reshape(shape))
        number += 1


def ffmpeg() -> Any:
    """Return the package that reads and writes videos.

    Raises
    ------
    MissingCapability
        It is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError:
        raise MissingCapability("videos need an extra package: pip install 'tactile-twin[video]'") from None
    return imageio_ffmpeg


def video_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a video file."""
    package = ffmpeg()
    if not path.is_file():
        yield Frame(name=path.name, problem="there is no such video")
        return
    try:
        with closing(package.read_frames(str(path), pix_fmt="rgb24")) as reader:
            width, height = next(reader)["size"]
            for number, data in enumerate(reader):
                picture = np.frombuffer(data, np.uint8).reshape(height, width, 3)
                yield Frame(name=f"{path.name}:{number}", picture=picture)
    except (OSError, RuntimeError, StopIteration, ValueError, KeyError) as problem:
        yield Frame(name=path.name, problem=f"can't be read as a video ({type(problem).__name__})")


class VideoWriter:
    """Writes pictures to a video file at 60 frames a second; whole only after `close`."""

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        self._sink = ffmpeg().write_frames(str(path), size, fps=60, macro_block_size=1, quality=8)
        self._sink.send(None)

    def add(self, picture: Picture) -> None:
        """Append a picture.

        Raises
        ------
        TwinError
            It can't be written.
        """
        try:
            self._sink.send(np.ascontiguousarray(picture))
        except (OSError, StopIteration) as problem:
            raise TwinError(f"the overlay video can't be written ({problem})") from None

    def close(self) -> None:
        """Finish the file."""
        self._sink.close()
