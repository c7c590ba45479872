"""Output that arrives in pieces is shown in one: myst-nb would end a line after each piece of a hundred characters."""

from myst_nb.core import render


def joined(outputs):
    """Merge the pieces of each stream as they came."""
    merged, streams = [], {}
    for output in outputs:
        name = output.get("name") if output["output_type"] == "stream" else None
        if name in streams:
            streams[name]["text"] += output["text"]
            continue
        merged.append(output)
        if name:
            streams[name] = output
    return merged


def setup(_app):
    """Take the place of myst-nb's own."""
    render.coalesce_streams = joined
    return {"parallel_read_safe": True, "parallel_write_safe": True}
