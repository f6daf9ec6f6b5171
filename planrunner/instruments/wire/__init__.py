"""Contains the parts that drivers of real instruments share: links, serial streams, framing, checksums and clocks. These parts do
not depend on manufacturers."""
