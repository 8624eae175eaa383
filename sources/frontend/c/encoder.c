#include "chachart_packet.h"

#include <string.h>

static uint8_t *put(uint8_t *p, uint64_t value, int bytes) {
    while (bytes--) { *p++ = (uint8_t)value; value >>= 8; }
    return p;
}

static uint8_t *put_float(uint8_t *p, float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    return put(p, bits, 4);
}

static uint8_t *put_double(uint8_t *p, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    return put(p, bits, 8);
}

static uint8_t *header(uint8_t *p, int type, int format, uint32_t sequence, uint64_t time_ns) {
    *p++ = CHACHART_VERSION; *p++ = (uint8_t)type; *p++ = (uint8_t)format; *p++ = 0;
    return put(put(p, sequence, 4), time_ns, 8);
}

static size_t finish(uint8_t *out, uint8_t *end) {
    uint32_t crc = 0xFFFFFFFFu;
    for (const uint8_t *p = out; p < end; p++) {
        crc ^= *p;
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return (size_t)(put(end, crc ^ 0xFFFFFFFFu, 4) - out);
}

size_t chachart_csi(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint64_t ue, uint16_t antennas,
                    uint16_t subcarriers, enum chachart_format format, float scale, const void *samples) {
    uint8_t *p = put(header(out, 1, format, sequence, time_ns), ue, 8);
    size_t count = (size_t)antennas * subcarriers * 2;
    p = put_float(put(put(p, antennas, 2), subcarriers, 2), scale);
    for (size_t i = 0; i < count; i++) {
        if (format == CHACHART_INT8) p = put(p, (uint8_t)((const int8_t *)samples)[i], 1);
        else if (format == CHACHART_INT16) p = put(p, (uint16_t)((const int16_t *)samples)[i], 2);
        else p = put_float(p, ((const float *)samples)[i]);
    }
    return finish(out, p);
}

size_t chachart_hello(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint16_t antennas, uint16_t subcarriers,
                      float element_spacing_m, double carrier_hz, double subcarrier_spacing_hz,
                      const char *serial) {
    return chachart_hello_elements(out, sequence, time_ns, antennas, subcarriers, element_spacing_m, carrier_hz,
                                   subcarrier_spacing_hz, serial, NULL);
}

size_t chachart_hello_elements(uint8_t *out, uint32_t sequence, uint64_t time_ns, uint16_t antennas,
                               uint16_t subcarriers, float element_spacing_m, double carrier_hz,
                               double subcarrier_spacing_hz, const char *serial, const float *elements) {
    uint8_t *p = put(put(header(out, 2, 0, sequence, time_ns), antennas, 2), subcarriers, 2);
    p = put_double(put_double(put_float(p, element_spacing_m), carrier_hz), subcarrier_spacing_hz);
    for (int i = 0; i < 16; i++) *p++ = (uint8_t)(*serial ? *serial++ : 0);
    for (int i = 0; elements && i < 3 * antennas; i++) p = put_float(p, elements[i]);
    return finish(out, p);
}

size_t chachart_heartbeat(uint8_t *out, uint32_t sequence, uint64_t time_ns) {
    return finish(out, header(out, 3, 0, sequence, time_ns));
}

size_t chachart_frame(uint8_t *out, const uint8_t *packet, size_t length) {
    uint8_t *p = out, *code;
    *p++ = 0;
    code = p++;
    *code = 1;
    for (size_t i = 0; i < length; i++) {
        if (packet[i]) { *p++ = packet[i]; ++*code; }
        if (!packet[i] || (*code == 0xFF && i + 1 < length)) { code = p++; *code = 1; }
    }
    *p++ = 0;
    return (size_t)(p - out);
}
