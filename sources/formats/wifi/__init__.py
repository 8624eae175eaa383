"""The captures of Wi-Fi cards, a module each: walk the structure, check the lengths, decode whole columns.

Every module has, beside what a format needs (`NAME`, `why_not`, `open_capture`), a `read` that takes bytes
and gives a `Log`: live sources call it with the bytes of one record, importers with those of a file.
"""
