"""Figures of commands as their texts: drawing one takes a second or two, and is tested in views."""


def write_texts(patch):
    """Have figures written as format, width in dots and texts, in place of their pictures."""
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    def savefig(figure, file, *, format, dpi, metadata):
        head = f"{format} {figure.get_figwidth() * dpi:.0f}"
        texts = [each.get_text() for each in figure.findobj(Text)]
        file.write("\n".join((head, *filter(None, texts))).encode("utf-8"))

    patch.setattr(Figure, "savefig", savefig)
