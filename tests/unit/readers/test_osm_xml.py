"""OSM XML as programs and people write it: one map in many texts; and what is not OSM XML."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from conetl.model.errors import InputError
from conetl.readers.base_layers import osm_xml
from conetl.readers.base_layers.osm_xml import read_osm

PLAIN = """<?xml version="1.0" encoding="UTF-8"?>
<osm version="0.6" generator="JOSM">
  <bounds minlat="1" minlon="2" maxlat="3" maxlon="4"/>
  <node id="-1" visible="true" lat="49.1" lon="8.1"><tag k="ele" v="100.5" /></node>
  <node id="-2" lat="49.2" lon="8.2" />
  <node id="-3" action="delete" lat="49.2" lon="8.2" />
  <node lon="8.3" lat="49.3" id="-4"/>
  <node lon="8.3" lat="x" id="-5"/>
  <node lon="8.9" lat="49.9" id="-4"/>
  <way id="-10">
    <nd ref="-1"/><nd ref="-2"/><nd ref="-4"/>
    <tag k="type" v="line_thin"/><tag v="O'Neil &quot;a&quot; &amp; &#252;ber" k="name"/>
  </way>
  <way id="-12" visible="false"><nd ref="-1"/><nd ref="-2"/></way>
  <way id="-13"><nd ref="-2"/><nd ref="x"/></way>
  <relation id="-20">
    <member type="way" ref="-13" role="right"/><member type="way" ref="-10" role="left"/><member role="x" ref="-99"/>
    <tag k="type" v="lanelet"/>
  </relation>
  <relation id="-21"><member type="way" ref="-98" role="right"/><tag k="type" v="regulatory_element"/></relation>
</osm>
"""
SHAPES = {
    "as many programs write it": PLAIN,
    "single quotes": PLAIN.replace("O'Neil", "O&apos;Neil").replace('"', "'"),
    "a declaration in other quotes": PLAIN.replace('"1.0" encoding="UTF-8"', "'1.0'"),
    "both quotes": PLAIN.replace('lat="49.1"', "lat='49.1'"),
    "a comment with an object": PLAIN.replace("<bounds", '<!-- <node id="7" lat="1" lon="1"/> --><bounds'),
    "a text": PLAIN.replace("<bounds", '<note>The "data"</note><bounds'),
    "a block of text": PLAIN.replace("<bounds", '<note><![CDATA[<node id="9"/>]]></note><bounds'),
    "no declaration": PLAIN.partition("\n")[2],
    "in one line": PLAIN.replace("\n", " "),
    "Windows": PLAIN.replace("\n", "\r\n"),
    "spaces around the equals sign": PLAIN.replace("lat=", "lat = ").replace("<tag k=", "<tag\n k="),
    "elements that are not closed at once": PLAIN.replace('<nd ref="-1"/>', '<nd ref="-1"></nd>'),
    "elements of others": PLAIN.replace("</way>", "<other><tag k='type' v='x'/></other></way>", 1),
    "an element without values": PLAIN.replace("<bounds", "<bounds/><bounds"),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("block_bytes", [None, 64, 300])
def test_one_map_in_many_texts(
    name: str, block_bytes: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if block_bytes:
        monkeypatch.setattr("conetl.files.documents._XML_BLOCK", block_bytes)
    path = tmp_path / "a.osm"
    path.write_bytes(SHAPES[name].encode())
    _check(path)


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1", "utf-8-sig"])
def test_other_encodings(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "a.osm"
    stated = encoding.removesuffix("-sig")
    path.write_text(
        PLAIN.replace("UTF-8", stated).replace("&#252;", "\N{LATIN SMALL LETTER U WITH DIAERESIS}"), encoding
    )
    _check(path)


def _check(path: Path) -> None:
    found = read_osm(path)
    assert found.node_ids.tolist() == [-4, -2, -1]
    expected = np.array([[8.9, 49.9, np.nan], [8.2, 49.2, np.nan], [8.1, 49.1, 100.5]])
    np.testing.assert_array_equal(found.lon_lat_ele, expected)
    assert {way: nodes.tolist() for way, (nodes, _) in found.ways.items()} == {
        -10: [-1, -2, -4],
        -13: [-2, osm_xml.NO_ID],
    }
    assert found.ways[-10][1] == {
        "type": "line_thin",
        "name": 'O\'Neil "a" & \N{LATIN SMALL LETTER U WITH DIAERESIS}ber',
    }
    assert found.lanelet_ways == {-10, -13}
    assert found.refused == ["node '-5': id, longitude, latitude or height is not a number"]


BROKEN = {
    "cut": PLAIN[: PLAIN.index("<relation")],
    "cut in a value": PLAIN[: PLAIN.index("49.9")],
    "an end too few": PLAIN.replace("</way>", "", 1),
    "an end too many": PLAIN.replace("</way>", "</way></way>", 1),
    "an end of another element": PLAIN.replace("</way>", "</node>", 1),
    "a value without quotes": PLAIN.replace('lat="49.1"', "lat=49.1"),
    "two roots": PLAIN + "<osm/>",
    "an unknown entity": PLAIN.replace("O'Neil", "&foo;").replace("<bounds", "<!-- --><bounds"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_text_is_refused_with_its_location(name: str, tmp_path: Path) -> None:
    path = tmp_path / "a.osm"
    path.write_text(BROKEN[name])
    with pytest.raises(InputError, match=r"a.osm: is not OSM XML \(.*line \d+.*; expected a Lanelet2 map"):
        read_osm(path)


def test_ids_that_are_no_numbers_cost_their_object(tmp_path: Path) -> None:
    path = tmp_path / "a.osm"
    path.write_text(
        PLAIN.replace('way id="-13"', 'way id="w"').replace('node id="-2"', 'node id="99999999999999999999"')
    )
    found = read_osm(path)
    assert set(found.ways) == {-10} and found.node_ids.tolist() == [-4, -1]
    assert [text.partition(":")[0] for text in found.refused] == ["node '99999999999999999999'", "node '-5'", "way 'w'"]


def test_an_encoding_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.osm"
    path.write_text(PLAIN.replace("UTF-8", "UTG-8"))
    with pytest.raises(InputError, match=r"is not OSM XML .*unknown encoding"):
        read_osm(path)


def test_objects_without_values_and_an_empty_map(tmp_path: Path) -> None:
    path = tmp_path / "a.osm"
    for text in ("<osm/>", "<osm></osm>", "<osm> \n</osm>", "<osm><node/></osm>", "<gpx><node/></gpx>"):
        path.write_text(text)
        assert not len(read_osm(path).node_ids)


def test_a_million_nodes_need_their_arrays_and_one_block(tmp_path: Path) -> None:
    path = tmp_path / "lanes.osm"
    nodes = "".join(f"<node id='{k}' lat='49.{k:06d}' lon='8.1'/>\n" for k in range(200_000))
    path.write_text(f"<osm>{nodes}</osm>")
    tracemalloc.start()
    try:
        assert len(read_osm(path).node_ids) == 200_000
        assert tracemalloc.get_traced_memory()[1] < 50e6, "120 MB with blocks of 4 MB"
    finally:
        tracemalloc.stop()


def test_a_map_of_which_nearly_nothing_can_be_used_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lanes.osm"
    path.write_text("<osm>" + "<node id='x' lat='49' lon='8'/>" * 20_001 + "</osm>")
    with pytest.raises(InputError, match="more than 20,000 of its records cannot be used; the first: node 'x': id"):
        read_osm(path)
