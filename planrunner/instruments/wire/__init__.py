"""What drivers of real instruments share: links, serial streams, framing, checksums and clocks. Nothing here knows a vendor."""
