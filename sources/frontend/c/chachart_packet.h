/* The chachart front-end packet, version 1 (see PACKET.md): a reference encoder in portable C99.
 * Every function writes one packet to `out`, CRC-32 included, and returns its length in bytes. */
#ifndef CHACHART_PACKET_H
#define CHACHART_PACKET_H

#include <stddef.h>
#include <stdint.h>

#define CHACHART_VERSION 1
#define CHACHART_HELLO_BYTES 60
#define CHACHART_HEARTBEAT_BYTES 20
#define CHACHART_CSI_OVERHEAD 36 /* a CSI packet has this and its samples */
#define CHACHART_FRAMED_BYTES(n) ((n) + (n) / 254 + 3) /* room for n bytes between their zeros */

enum chachart_format { CHACHART_INT8 = 0, CHACHART_INT16 = 1, CHACHART_FLOAT32 = 2 };

/* samples: antennas x subcarriers x (I, Q), subcarriers running faster than antennas, of the C type that
 * `format` names: int8_t, int16_t or float. The channel is scale * (I + jQ). */
size_t chachart_csi(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint64_t ue, uint16_t antennas,
                    uint16_t subcarriers, enum chachart_format format, float scale, const void *samples);

/* sequence: of the CSI packet to come next. element_spacing_m: 0 if not known. serial: at most 16 characters. */
size_t chachart_hello(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint16_t antennas, uint16_t subcarriers,
                      float element_spacing_m, double carrier_hz, double subcarrier_spacing_hz,
                      const char *serial);

/* The same of an array that is no uniform line: elements has the position of each antenna along right, up and
 * normal, in metres, one after the other; 12 bytes each come on top of CHACHART_HELLO_BYTES. */
size_t chachart_hello_elements(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint16_t antennas,
                               uint16_t subcarriers, float element_spacing_m, double carrier_hz,
                               double subcarrier_spacing_hz, const char *serial, const float *elements);

size_t chachart_heartbeat(uint8_t *out, uint32_t sequence, uint64_t time_ns);

/* A packet as it goes over a serial line: zero, COBS, zero. `out` has room for CHACHART_FRAMED_BYTES(length). */
size_t chachart_frame(uint8_t *out, const uint8_t *packet, size_t length);

#endif
