"""Text from users in messages: one line, printable, and never long."""

from hypothesis import given
from hypothesis import strategies as st

from sim.errors import quote, shorten


@given(text=st.text(max_size=300), most=st.integers(10, 120))
def test_a_text_is_shown_in_one_short_printable_line(text: str, most: int):
    assert len(shorten(text, most)) <= most
    assert shorten(text, most).isprintable()
    assert len(quote(text, most)) <= most
    if text.isprintable() and len(text) <= most:
        assert shorten(text, most) == text
