"""Small files that refer to one large item many times, so that they unfold to a huge table."""

import zipfile

import numpy as np

TEXT, ROWS, REFERENCES = b"x" * (1 << 20), 5000, 40_000


def shared_texts(target, rows, texts):
    """A workbook of two columns of numbers and one of references to the first of shared texts."""
    import openpyxl
    book = openpyxl.Workbook()
    for k in range(rows):
        book.active.append([k, 2.0 * k, "x"])
    plain = target.with_suffix(".plain.xlsx")
    book.save(plain)
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    part = f'<Override PartName="/xl/sharedStrings.xml" ContentType="{kind}"/></Types>'.encode()
    with zipfile.ZipFile(plain) as before, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as z:
        for name in before.namelist():
            content = before.read(name).replace(b"</Types>", part)
            z.writestr(name, content.replace(b't="inlineStr"><is><t>x</t></is>', b't="s"><v>0</v>'))
        z.writestr("xl/sharedStrings.xml", f'<sst xmlns="{main}">'.encode() + texts + b"</sst>")
    plain.unlink()
    return target


def shared_array(target):
    """An HDF5 file whose 40,000 rows are one array of 160 kB."""
    import h5py
    with h5py.File(target, "w") as file:
        rows = file.create_dataset("t", (REFERENCES,), h5py.vlen_dtype(float))
        rows[0] = np.arange(20_000.0)
        first = rows.id.get_offset()
    content = bytearray(target.read_bytes())
    content[first : first + 16 * REFERENCES] = content[first : first + 16] * REFERENCES
    target.write_bytes(content)
    return target


def dictionary_text(target):
    """A Parquet file with a column whose 5,000 rows are one text of a dictionary."""
    import pyarrow
    from pyarrow import parquet
    rows, numbers = pyarrow.array(np.zeros(ROWS, "i4")), np.arange(float(ROWS))
    text = pyarrow.DictionaryArray.from_arrays(rows, pyarrow.array([TEXT.decode()]))
    table = pyarrow.table({"time_s": numbers, "voltage_V": numbers, "note": text})
    parquet.write_table(table, target, compression="zstd")
    return target
