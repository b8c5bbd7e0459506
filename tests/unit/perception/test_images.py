"""Image files, whole and broken. A truncated one must never yield pixels."""

from __future__ import annotations

import errno
import io
import struct
import zlib
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from conetl.model.errors import StorageError
from conetl.model.rejections import RejectionReason
from conetl.perception import images
from conetl.perception.image_headers import ImageFormatError, ImageTruncatedError, inspect_image
from conetl.perception.images import ImageFileError, check_image_ends, read_bytes, read_image, read_upright_image

SIZE = (64, 48)
IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)


def encoded(suffix: str, image: np.ndarray = IMAGE, *flags: int) -> bytes:
    good, data = cv2.imencode(suffix, image, list(flags))
    assert good
    return bytes(data)


JPEG, PNG = encoded(".jpg"), encoded(".png")
PROGRESSIVE = encoded(".jpg", IMAGE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2)


def written(folder: Path, data: bytes, name: str = "0000000001.jpg") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def with_pillow(kind: str, **options: object) -> bytes:
    file = BytesIO()
    Image.fromarray(IMAGE[..., ::-1].copy()).save(file, kind, **options)
    return file.getvalue()


OTHERS = {
    "tiff": encoded(".tif"), "tiff of one strip": with_pillow("TIFF"), "tiff LZW": with_pillow("TIFF", compression="tiff_lzw"),
    "bmp": encoded(".bmp"), "webp": encoded(".webp", IMAGE, cv2.IMWRITE_WEBP_QUALITY, 90),
    "webp lossless": with_pillow("WEBP", lossless=True), "webp with EXIF": with_pillow("WEBP", exif=b"Exif\0\0II*\0" + bytes(40)),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_tiff_bmp_and_webp_are_read_whole_or_not_at_all(name: str, tmp_path: Path) -> None:
    data = OTHERS[name]
    assert inspect_image(data) == (name.split(maxsplit=1)[0], *SIZE)
    image = read_image(written(tmp_path, data), SIZE)
    np.testing.assert_array_equal(image, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    assert check_image_ends(written(tmp_path, data), "x", SIZE).format == name.split(maxsplit=1)[0]
    for length in (3, 20, 30, len(data) // 2, len(data) - 30):
        with pytest.raises(ImageFileError, match=r"ends|neither|begins|no known|key frame"):
            read_image(written(tmp_path, data[:length]), SIZE)


@pytest.mark.parametrize("data", [JPEG, PNG, PROGRESSIVE], ids=["jpeg", "png", "progressive with restarts"])
def test_whole_images_are_read(tmp_path: Path, data: bytes) -> None:
    header = inspect_image(data)
    assert (header.width_px, header.height_px) == SIZE
    image = read_image(written(tmp_path, data), SIZE)
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    if data is PNG:
        np.testing.assert_array_equal(image, IMAGE)


def test_grey_and_16_bit_images_become_three_channels(tmp_path: Path) -> None:
    grey = IMAGE[:, :, 0]
    image = read_image(written(tmp_path, encoded(".png", grey), "grey.png"), SIZE)
    np.testing.assert_array_equal(image, np.repeat(grey[:, :, None], 3, axis=2))
    deep = read_image(written(tmp_path, encoded(".png", grey.astype(np.uint16) * 257), "deep.png"), SIZE)
    np.testing.assert_array_equal(deep[:, :, 0], grey)


@settings(deadline=None, max_examples=150)
@given(st.sampled_from([JPEG, PNG, PROGRESSIVE]), st.floats(0, 1, exclude_max=True))
def test_a_image_cut_anywhere_is_refused(data: bytes, share: float) -> None:
    cut = data[: int(share * len(data))]
    with pytest.raises((ImageTruncatedError, ImageFormatError)):
        inspect_image(cut)


@pytest.mark.parametrize("data", [JPEG, PNG], ids=["jpeg", "png"])
def test_a_cut_image_never_shows_the_one_read_before(tmp_path: Path, data: bytes) -> None:
    read_image(written(tmp_path, data), SIZE)
    with pytest.raises(ImageFileError) as raised:
        read_image(written(tmp_path, data[: len(data) // 2]), SIZE)
    assert raised.value.reason is RejectionReason.IMAGE_TRUNCATED


def test_a_cut_jpeg_that_was_filled_with_zeros_is_truncated() -> None:
    with pytest.raises(ImageTruncatedError, match="end marker"):
        inspect_image(JPEG[: len(JPEG) // 2] + bytes(5000))
    assert inspect_image(JPEG + bytes(500)).format == "jpeg", "padding after the end marker does no harm"


def test_a_thumbnails_end_marker_does_not_count() -> None:
    thumbnail = b"Exif\0\0" + JPEG
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    with_thumbnail = JPEG[:2] + segment + JPEG[2:]
    assert inspect_image(with_thumbnail)[1:] == SIZE
    with pytest.raises(ImageTruncatedError):
        inspect_image(JPEG[:2] + segment)
    with pytest.raises(ImageTruncatedError):
        inspect_image(with_thumbnail[: 2 + len(segment) + 800])


def test_a_png_with_a_damaged_chunk_is_unreadable() -> None:
    damaged = bytearray(PNG)
    damaged[len(PNG) // 2] ^= 0xFF
    with pytest.raises(ImageFormatError, match="checksum"):
        inspect_image(bytes(damaged))


def test_a_jpeg_with_damaged_pixels_is_unreadable(tmp_path: Path) -> None:
    """Its header and end are whole; OpenCV shows grey or torn pixels from the damage on."""
    damaged = JPEG[: len(JPEG) // 2] + JPEG[len(JPEG) // 2 + 40 :]
    inspect_image(damaged)
    with pytest.raises(ImageFileError, match=r"0000000001\.jpg: .*[Cc]orrupt JPEG data.*; copy it again") as raised:
        read_image(written(tmp_path, damaged), SIZE)
    assert raised.value.reason is RejectionReason.IMAGE_UNREADABLE


@pytest.mark.parametrize("data", [b"", b"GIF89a" + bytes(100), b"<html>not found</html>", b"\xff\xd8\x00\x00" * 9])
def test_what_is_no_image_is_unreadable(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(ImageFileError) as raised:
        read_image(written(tmp_path, data), SIZE)
    assert raised.value.reason is RejectionReason.IMAGE_UNREADABLE
    assert "0000000001.jpg" in str(raised.value)


def test_the_size_is_checked_before_the_decoder_sees_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ImageFileError, match="64 x 48 pixels, but the calibration is for 1242 x 375") as raised:
        read_image(written(tmp_path, PNG), (1242, 375))
    assert raised.value.reason is RejectionReason.IMAGE_WRONG_SIZE
    monkeypatch.setattr(images, "MAX_IMAGE_PIXELS", 1000)
    with pytest.raises(ImageFileError, match="too many"):
        read_image(written(tmp_path, PNG))


def test_a_header_that_claims_more_than_the_file_can_hold_is_refused_before_decoding(tmp_path: Path) -> None:
    for width, height, words in (
        (60_000, 60_000, "too many"),
        (10_000, 10_000, "too many for"),
        (2, 2**31, "too many"),
    ):
        header = b"IHDR" + struct.pack(">II", width, height) + PNG[24:29]
        lying = PNG[:12] + header + struct.pack(">I", zlib.crc32(header)) + PNG[33:]
        with pytest.raises(ImageFileError, match=words):
            read_image(written(tmp_path, lying))
        with pytest.raises(ImageFileError, match=words):
            images.check_image_ends(written(tmp_path, lying + bytes(2**17)), "a.png", (width, height))


def test_huge_files_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "MAX_FILE_BYTES", 100)
    with pytest.raises(ImageFileError, match="not read"):
        read_image(written(tmp_path, JPEG), SIZE)


def test_orientation_tags_do_not_turn_the_image(tmp_path: Path) -> None:
    tiff = b"MM\0*\0\0\0\x08" + b"\0\x01" + b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0" + bytes(4)
    body = b"Exif\0\0" + tiff
    turned = JPEG[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + JPEG[2:]
    flat = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert flat.shape[:2] == (64, 48), "OpenCV would turn it"
    assert read_image(written(tmp_path, turned), SIZE).shape[:2] == (48, 64)


def _encoded(image: Image.Image, kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def test_any_image_is_read_as_a_person_sees_it(tmp_path: Path) -> None:
    """Orange left half, black right half, in each way that a file can store it."""
    rgb = np.zeros((40, 60, 3), np.uint8)
    rgb[:, :30] = (230, 80, 20)
    plain = Image.fromarray(rgb)
    turned = Image.Exif()
    turned[0x112] = 3  # stored upside down
    clear = np.dstack((rgb, np.full((40, 60), 255, np.uint8)))
    clear[:, 30:, 3] = 0
    files = {
        "plain.png": _encoded(plain, "PNG"),
        "cmyk.jpg": _encoded(plain.convert("CMYK"), "JPEG", quality=95),
        "turned.jpg": _encoded(plain.rotate(180), "JPEG", exif=turned, quality=95),
        "clear.png": _encoded(Image.fromarray(clear, "RGBA"), "PNG"),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        found = read_upright_image(tmp_path / name)
        assert found.shape == (40, 60, 3) and found.dtype == np.uint8, name
        np.testing.assert_allclose(found[20, 10], (20, 80, 230), atol=6, err_msg=name)
        np.testing.assert_allclose(found[20, 50], 128 if name == "clear.png" else 0, atol=6, err_msg=name)


def test_a_16_bit_image_that_uses_12_bits_is_not_black(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 4095, 256).astype(np.uint16), (40, 1))
    (tmp_path / "deep.png").write_bytes(cv2.imencode(".png", ramp)[1].tobytes())
    found = read_upright_image(tmp_path / "deep.png")
    np.testing.assert_allclose(found[0, :, 1], np.arange(256), atol=3)


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.EMFILE, errno.ETIMEDOUT])
@pytest.mark.parametrize("call", ["stat", "read_bytes", "open"])
def test_a_moment_of_bad_storage_is_no_property_of_the_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, call: str
) -> None:
    path = written(tmp_path, JPEG * 400)

    def fail(*_: object, **__: object) -> None:
        raise OSError(number, "of the storage", str(path))

    with monkeypatch.context() as failing:
        failing.setattr(Path, call, fail)
        with pytest.raises(StorageError, match=r"0000000001\.jpg.*of the storage.*run the same command again"):
            read_bytes(path) if call != "open" else check_image_ends(path, path.name, SIZE)
    assert read_bytes(path) == JPEG * 400


@pytest.mark.parametrize(("mode", "error"), [(0o000, ImageFileError), (0o644, StorageError)])
def test_a_refusal_lasts_where_the_files_own_mode_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, error: type[Exception]
) -> None:
    """An expired ticket of a network file system refuses as well, but not for good."""
    path = written(tmp_path, JPEG)
    path.chmod(mode)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_bytes", refuse)  # root may read anything
    with pytest.raises(error, match="Permission denied"):
        read_bytes(path)


def test_no_file_and_a_folder_are_properties_of_the_image(tmp_path: Path) -> None:
    (tmp_path / "folder.jpg").mkdir()
    (tmp_path / "loop.jpg").symlink_to(tmp_path / "loop.jpg")
    written(tmp_path, JPEG)
    missing, other = "there is no such file", "this is a folder, a pipe or a broken link, not a file"
    for name, found in {
        "missing.jpg": missing, "0000000001.jpg/below.jpg": missing, "folder.jpg": other, "loop.jpg": other,
    }.items():  # fmt: skip
        with pytest.raises(ImageFileError, match=f"{Path(name).name}: {found}") as raised:
            read_image(tmp_path / name)
        assert raised.value.reason is RejectionReason.IMAGE_MISSING
