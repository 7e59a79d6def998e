"""How the energies of a cloth's vertices are added up: always in one order, for the same bits every time."""

from simcore.lang import on_cpu, ti


@ti.func
def add_up(parts: ti.template(), out: ti.template()):
    """Add the sum of each ``parts`` [n, rows, columns] to ``out`` [n]; what ``parts`` held is lost.

    On a GPU a thread for each row and then one for each cloth: a single one for all of a cloth's vertices waits for
    thousands of loads in turn.
    """
    count, rows, columns = parts.shape[0], parts.shape[1], parts.shape[2]
    if ti.static(on_cpu()):
        ti.loop_config(serialize=True)
        for n in range(count):
            total = ti.cast(0.0, ti.f64)
            for j in range(rows):
                for i in range(columns):
                    total = total + parts[n, j, i]
            out[n] = out[n] + total
    else:
        for n, j in ti.ndrange(count, rows):
            total = ti.cast(0.0, ti.f64)
            for i in range(columns):
                total = total + parts[n, j, i]
            parts[n, j, 0] = total
        for n in range(count):
            total = ti.cast(0.0, ti.f64)
            for j in range(rows):
                total = total + parts[n, j, 0]
            out[n] = out[n] + total
