"""Array front-ends behind a serial line or a CAN bus: one packet (PACKET.md), two links."""
