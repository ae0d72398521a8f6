"""Text of others, made harmless for a terminal.

A vehicle, a file or its name can hold anything: escape sequences that recolor, clear or write
to a terminal, line breaks that forge lines, marks that turn text around. Shown are their codes.
"""

LONGEST_LINE = 1000
"""Characters; the middle of a longer line is left out."""


def printable(text: str) -> str:
    """Text that moves no cursor: characters that print nothing become their codes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    """One printable line of bearable length."""
    text = printable(text)
    if len(text) > LONGEST_LINE:
        half = LONGEST_LINE // 2 - 3
        text = f"{text[:half]} ... {text[-half:]}"
    return text
