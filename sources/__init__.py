"""Where CSI comes from: simulator, recordings, ZeroMQ producers, array front-ends."""
