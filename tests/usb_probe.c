// SPDX-License-Identifier: Apache-2.0
//
// usb_probe.c - lists the controllers that are plugged in, one a line: kind, serial, path, and what is wrong with it. A
// program of its own, to show that another process than the emulator's sees the emulated boards.
#include <stdio.h>

#include "usb.h"

static void say(const char *line) { fprintf(stderr, "usb_probe: %s\n", line); }

int main(void)
{
    struct usb *u;
    struct usb_found found[64];
    struct fault f = { 0 };
    if (usb_create(&u, say, &f)) {
        fprintf(stderr, "usb_probe: %s\n", f.text);
        return 1;
    }
    const unsigned n = usb_list(u, found, 64, 3000);
    for (unsigned i = 0; i < n; i++)
        printf("%s %s %s %s%s\n", panel_kinds[found[i].kind]->name, found[i].serial[0] ? found[i].serial : "-", found[i].path,
               found[i].twice ? "twice " : "", found[i].why);
    usb_destroy(u);
    return 0;
}
