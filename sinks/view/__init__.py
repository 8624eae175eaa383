"""The live view: page, WebSocket, HTTP control, health and metrics on one port."""
