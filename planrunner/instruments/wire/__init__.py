"""Contains what drivers of real instruments share: links, serial streams, framing, checksums and clocks. Nothing here is specific
to a manufacturer."""
