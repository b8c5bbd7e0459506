"""Names of strangers in Markdown."""

from __future__ import annotations

from html import escape

from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from conetl.files.names import as_markdown, printable

MARKDOWN = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0") | st.sampled_from("\\`*_~<>[]()!|&:@#- \n")))
@example("<img src=x onerror=alert(1)>`](elsewhere)** ~~a~~ &lt; <http://a.example> ![b](c)")
def test_any_text_in_markdown_is_shown_as_it_is(text: str) -> None:
    shown = escape(" ".join(printable(text, lines=True).split()), quote=False).replace('"', "&quot;")
    assert MARKDOWN.renderInline(as_markdown(text)) == shown
    row = MARKDOWN.render(f"| a | b |\n|---|---|\n| {as_markdown(text)} | c |")
    assert f"<td>{shown}</td>\n<td>c</td>" in row


def test_addresses_become_no_links() -> None:
    assert as_markdown("www.a.example http://b.example c@d.example") == (
        r"www\.a.example http\://b.example c\@d.example"
    )


@given(st.text())
def test_no_control_character_is_printable(text: str) -> None:
    shown = printable(text)
    assert not any(c < " " or "\x7f" <= c <= "\x9f" or c in "\u202e\u2066\u2028" for c in shown)
    assert printable(shown) == shown
    kept = printable(text, lines=True)
    assert kept.count("\n") == text.count("\n") and kept.replace("\n", "").replace("\t", "") == printable(
        text.replace("\n", "").replace("\t", "")
    )


def test_a_title_of_a_terminal_and_a_text_from_the_right_are_shown_as_codes() -> None:
    assert printable("\x1b]0;title\x07 \u202egpj.exe\n") == "\\x1b]0;title\\x07 \\u202egpj.exe\\n"
