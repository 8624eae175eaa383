"""5G: channel estimates of sounding reference signals, from the T tracer of an OpenAirInterface gNB."""
