"""The members of one large JSON object, read as its text arrives.

Only one element is held at a time, and the text of at most one element is scanned again when more of it arrives:
memory is bounded by the largest element, time is linear.
"""

from __future__ import annotations

import codecs
import json
from collections.abc import Iterable, Iterator

from slamcu_core.errors import FormatError
from slamcu_core.formats.fields import DECODER, Place

MAX_ELEMENT = 1 << 20
"""Characters that one element may take."""

_WHITESPACE = " \t\n\r"
_NEARLY_COMPLETE = 16  # characters from the end of the text within which a broken literal may only be cut short


class JsonObjectStream:
    """Reads a JSON object member by member, and the list under one name element by element.

    Parameters
    ----------
    chunks : the text in pieces of any size, as text or UTF-8.
    source : its name, for errors.
    """

    def __init__(self, chunks: Iterable[str | bytes], source: str | None) -> None:
        self._chunks = iter(chunks)
        self._source = source
        self._utf8 = codecs.getincrementaldecoder("utf-8")()
        self._text = ""
        self._at = 0
        self._line = 1  # of the character at self._counted
        self._counted = 0
        self._ended = False
        self.value_line = 1
        """The line on which the last value began."""

    def place(self) -> Place:
        """Return where reading stands."""
        return Place(self._source, self._line_here())

    def _line_here(self) -> int:
        self._line += self._text.count("\n", self._counted, self._at)
        self._counted = self._at
        return self._line

    def members(self, streamed: str) -> Iterator[tuple[str, object]]:
        """Iterate over (name, value); the list `streamed` comes as one pair for each of its elements, then END_OF_LIST.

        Raises FormatError.
        """
        self._fill(1)
        self._text = self._text.removeprefix("\ufeff")
        self._expect("{", "the file is not a JSON object")
        if self._peek() == "}":
            self._at += 1
        else:
            more = True
            while more:
                if self._peek() != '"':
                    raise self._error("expected the name of a member in quotes")
                name = str(self._decode())
                self._expect(":", f'expected ":" after "{name[:60]}"')
                if name == streamed:
                    if self._peek() != "[":
                        raise self._error(f'expected a list under "{name}"')
                    for element in self._elements():
                        yield name, element
                    yield name, END_OF_LIST
                else:
                    yield name, self._decode()
                more = self._more("}")
        if self._peek():
            raise self._error("expected nothing after the object")

    def _elements(self) -> Iterator[object]:
        self._at += 1
        if self._peek() == "]":
            self._at += 1
            return
        more = True
        while more:
            yield self._decode()
            more = self._more("]")

    def _more(self, closing: str) -> bool:
        """Say whether another element follows; the comma or the closing bracket is consumed."""
        found = self._peek()
        if found not in (",", closing) or not found:
            raise self._error(f'expected "," or "{closing}"' + ("" if found else ", but the file ends"))
        self._at += 1
        return found == ","

    def _expect(self, wanted: str, message: str) -> None:
        if self._peek() != wanted:
            raise self._error(message)
        self._at += 1

    def _peek(self) -> str:
        """Return the next character that is not white space, "" at the end."""
        while True:
            while self._at < len(self._text):
                if self._text[self._at] not in _WHITESPACE:
                    return self._text[self._at]
                self._at += 1
            if self._ended:
                return ""
            self._fill(1)

    def _decode(self) -> object:
        """Return the value that starts here."""
        self._peek()
        self.value_line = self._line_here()
        wanted = 1 << 12
        while True:
            self._fill(wanted)
            try:
                value, end = DECODER.raw_decode(self._text, self._at)
            except json.JSONDecodeError as error:
                if self._broken(error):
                    self._at = error.pos
                    raise self._error(f"not valid JSON: {error.msg}") from error
            except (ValueError, RecursionError) as error:
                raise self._error(f"not valid JSON: {error}") from error
            else:
                if end < len(self._text) or self._ended:  # else a number may go on
                    self._at = end
                    return value
            if len(self._text) - self._at > MAX_ELEMENT:
                raise self._error(f"one element takes more than {MAX_ELEMENT} characters")
            wanted = 2 * (len(self._text) - self._at) + 1

    def _broken(self, error: json.JSONDecodeError) -> bool:
        """Say whether more text cannot mend what the decoder stumbled over."""
        if self._ended:
            return True
        return not error.msg.startswith("Unterminated") and error.pos + _NEARLY_COMPLETE < len(self._text)

    def _fill(self, wanted: int) -> None:
        """Read until so many characters are ahead, or the end."""
        ahead = len(self._text) - self._at
        if ahead >= wanted or self._ended:
            return
        self._line_here()
        pieces = [self._text[self._at :]]
        while ahead < wanted and not self._ended:
            piece = self._next_piece()
            ahead += len(piece)
            pieces.append(piece)
        self._text, self._at, self._counted = "".join(pieces), 0, 0

    def _next_piece(self) -> str:
        chunk = next(self._chunks, None)
        self._ended = chunk is None
        if isinstance(chunk, str):
            return chunk
        try:
            return self._utf8.decode(chunk or b"", final=self._ended)
        except UnicodeDecodeError as error:
            raise self._error("not UTF-8") from error

    def _error(self, message: str) -> FormatError:
        return self.place().error(message)


class _EndOfList:
    """Marks the end of the streamed list."""


END_OF_LIST = _EndOfList()
