"""Common parts of drivers of real instruments: links, serial streams, framing, checksums and clocks. Nothing here is specific to a
vendor."""
