"""Wrong images: changes of a copy of a drive folder in the KITTI layout, whose files stay well-formed."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.prepared import prepared

Image = NDArray[np.uint8]
ImageMutant = Callable[[Image], Image]
PairMutant = Callable[[Image, Image], tuple[Image, Image]]
FolderMutant = Callable[[Path], None]
CAMERAS = ("image_02", "image_03")


def copy_drive(source: Path, folder: Path) -> Path:
    """The folder with a copy of a drive's images, log and calibration."""
    return Path(shutil.copytree(source, folder, ignore=shutil.ignore_patterns("velodyne_points")))


@prepared
def changed(folder: Path, mutant: PairMutant, first: float = 0.0) -> None:
    """All pairs after this share of the drive, read, changed and written under their names."""
    lefts = sorted((folder / CAMERAS[0] / "data").iterdir())
    for path in lefts[int(first * len(lefts)) :]:
        files = (path, folder / CAMERAS[1] / "data" / path.name)
        left, right = (np.asarray(cv2.imread(str(file)), np.uint8) for file in files)
        for file, image in zip(files, mutant(left, right), strict=True):
            cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


def both(change: ImageMutant) -> PairMutant:
    return lambda left, right: (change(left), change(right))


def only_left(change: ImageMutant) -> PairMutant:
    return lambda left, right: (change(left), right)


def only_right(change: ImageMutant) -> PairMutant:
    return lambda left, right: (left, change(right))


def swapped(left: Image, right: Image) -> tuple[Image, Image]:
    return right, left


def darker(share: float) -> ImageMutant:
    return lambda image: (image * share).astype(np.uint8)


def gamma(power: float) -> ImageMutant:
    """Another brightness curve."""
    levels = (255 * (np.arange(256) / 255) ** power).round().astype(np.uint8)
    return lambda image: levels[image]


def foggier(share: float) -> ImageMutant:
    return lambda image: (image * (1.0 - share) + 200.0 * share).astype(np.uint8)


def blurred(sigma_px: float) -> ImageMutant:
    return lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)


@prepared
def smeared(image: Image, sigma_px: float, top: float = 0.55, left: float = 0.0) -> Image:
    """Blurred below and to the right of these shares of height and width."""
    part = image.copy()
    rows, columns = int(top * image.shape[0]), int(left * image.shape[1])
    part[rows:, columns:] = cv2.GaussianBlur(image, (0, 0), sigma_px)[rows:, columns:]
    return part


def overexposed(gain: float) -> ImageMutant:
    return lambda image: np.asarray(np.clip(image * gain, 0, 255), np.uint8)


@prepared
def glare(image: Image, sigma: float) -> Image:
    """A low sun in the middle; sigma: of its glow, as a share of the image's width."""
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    off2 = (rows - image.shape[0] / 2) ** 2 + (columns - image.shape[1] / 2) ** 2
    glow = 400.0 * np.exp(-off2 / (2 * (sigma * image.shape[1]) ** 2))
    return np.asarray(np.clip(image + glow[..., None], 0, 255), np.uint8)


@prepared
def compressed(image: Image, quality: int) -> Image:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def salted(share: float) -> ImageMutant:
    """This share of the pixels is white, others in every image."""
    random = np.random.default_rng(1)

    def change(image: Image) -> Image:
        white = random.random(image.shape[:2])[..., None] < share
        return np.where(white, np.uint8(255), image).astype(np.uint8)

    return change


@prepared
def shifted(image: Image, rows: int, columns: int) -> Image:
    """The scene lies so many rows lower and columns farther right; the edges are repeated."""
    height, width = image.shape[:2]
    at_rows = np.clip(np.arange(height) - rows, 0, height - 1)
    return image[at_rows][:, np.clip(np.arange(width) - columns, 0, width - 1)]


@prepared
def covered(image: Image, top: float = 0.0, bottom: float = 1.0, left: float = 0.0, right: float = 1.0) -> Image:
    """Black between shares of height and width."""
    height, width = image.shape[:2]
    dark = image.copy()
    dark[int(top * height) : int(bottom * height), int(left * width) : int(right * width)] = 0
    return dark


@prepared
def distorted(image: Image, k1: float, focal: float = 0.58) -> Image:
    """By a lens of other radial distortion; focal: its focal length as a share of the image's width."""
    height, width = image.shape[:2]
    x, y = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    scale = 1 - k1 * (x * x + y * y) / (focal * width) ** 2
    columns, rows = ((part * scale + size / 2).astype(np.float32) for part, size in ((x, width), (y, height)))
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_CUBIC), np.uint8)


def stretched(rows: float) -> ImageMutant:
    """The scene is so many times as tall around the middle of the image, as in a video of another aspect ratio."""

    def change(image: Image) -> Image:
        height, width = image.shape[:2]
        about_middle = np.array([[1.0, 0.0, 0.0], [0.0, rows, (1 - rows) * height / 2]])
        border = cv2.BORDER_REPLICATE
        return np.asarray(
            cv2.warpAffine(image, about_middle, (width, height), flags=cv2.INTER_CUBIC, borderMode=border), np.uint8
        )

    return change


@prepared
def another_day(folder: Path, other: Path, hours: int) -> None:
    """The records of another drive follow, recorded so many hours after the beginning of this one."""
    count = len(list((folder / CAMERAS[0] / "data").iterdir()))
    for name in (*CAMERAS, "oxts"):
        for file in (other / name / "data").iterdir():
            shutil.copy(file, folder / name / "data" / f"{int(file.stem) + count:010d}{file.suffix}")
        stamps, later = folder / name / "timestamps.txt", other / name / "timestamps.txt"
        if stamps.is_file():
            own, others = (np.array(file.read_text().split("\n"), "datetime64[ns]") for file in (stamps, later))
            others = own[0] + np.timedelta64(hours, "h") + (others - others[0])
            text = "\n".join(str(stamp).replace("T", " ") for stamp in (*own, *others) if not np.isnat(stamp))
            stamps.write_text(f"{text}\n")


def mirrored(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def upside_down(image: Image) -> Image:
    return np.ascontiguousarray(image[::-1, ::-1])


@prepared
def frozen(folder: Path, *cameras: str, first: float = 0.0) -> None:
    """The cameras repeat the image at this share of the drive from there on."""
    for camera in cameras:
        files = sorted((folder / camera / "data").iterdir())
        start = int(first * len(files))
        for path in files[start + 1 :]:
            shutil.copy(files[start], path)


def blended(folder: Path) -> None:
    """Each image is the mean of itself and the one before, as where a converter changes the frame rate."""
    for camera in CAMERAS:
        files = sorted((folder / camera / "data").iterdir())
        images = [np.asarray(cv2.imread(str(file)), np.uint8) for file in files]
        for file, before, image in zip(files[1:], images[:-1], images[1:], strict=True):
            cv2.imwrite(str(file), cv2.addWeighted(before, 0.5, image, 0.5, 0), [cv2.IMWRITE_JPEG_QUALITY, 95])


@prepared
def torn(folder: Path, row: float, *cameras: str, pairs: slice = slice(1, None)) -> None:
    """Below this share of the height the images of these pairs show those before, as where a buffer is overwritten while read."""
    for camera in cameras or CAMERAS:
        files = sorted((folder / camera / "data").iterdir())
        images = [np.asarray(cv2.imread(str(file)), np.uint8) for file in files]
        for k in range(len(files))[pairs]:
            image, first = images[k].copy(), int(row * len(images[k]))
            image[first:] = images[k - 1][first:]
            cv2.imwrite(str(files[k]), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


@prepared
def with_hood(folder: Path, top: float) -> None:
    """The vehicle's own hood from this share of the height on in the middle, lower at the sides; with noise of a sensor."""
    random = np.random.default_rng(1)
    for camera in CAMERAS:
        for file in (folder / camera / "data").iterdir():
            image = np.asarray(cv2.imread(str(file)), np.uint8)
            rows, columns = np.ogrid[: image.shape[0], -1 : 1 : image.shape[1] * 1j]
            hood = rows > (top + 0.08 * columns**2) * len(image)
            shine = 90 + 40 * np.sin(6 * columns) + 0.1 * rows + random.normal(0.0, 3.0, image.shape[:2])
            image[hood] = np.clip(shine, 0, 255).astype(np.uint8)[hood][:, None]
            cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


@prepared
def log(folder: Path, change: Callable[[Sequence[float]], Sequence[float]], first: int = 0, last: int = 3) -> None:
    """Other fields in every record of the GNSS/INS log: latitude, longitude and height (degrees, m) unless others are named."""
    for path in (folder / "oxts" / "data").iterdir():
        fields = path.read_text().split()
        fields[first:last] = [f"{value:.12f}" for value in change([*map(float, fields[first:last])])]
        path.write_text(" ".join(fields))
