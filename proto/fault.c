// SPDX-License-Identifier: Apache-2.0
// fault.c - the table of fault.h as functions.
#include "fault.h"

#include <stdarg.h>
#include <stdio.h>

int fault_set(struct fault *f, enum fault_code code, const char *field, const char *format, ...)
{
    if (!f)
        return -1;
    *f = (struct fault){ .code = code };
    snprintf(f->field, sizeof(f->field), "%s", field ? field : "");
    va_list args;
    va_start(args, format);
    vsnprintf(f->text, sizeof(f->text), format, args);
    va_end(args);
    return -1;
}

struct fault_row {
    enum fault_code code;
    const char *symbol;
    bool retryable, closes;
};

static const struct fault_row rows[] = {
#define X(code, symbol, retryable, closes, text) { code, #symbol, retryable, closes },
    AIRY_FAULTS(X)
#undef X
};

static const struct fault_row *row_of(enum fault_code code)
{
    static const struct fault_row unknown = { FAULT_NONE, "UNKNOWN", false, false };
    for (unsigned i = 0; i < sizeof(rows) / sizeof(rows[0]); i++)
        if (rows[i].code == code)
            return &rows[i];
    return &unknown;
}

const char *fault_symbol(enum fault_code code) { return row_of(code)->symbol; }
bool fault_retryable(enum fault_code code) { return row_of(code)->retryable; }
bool fault_closes(enum fault_code code) { return row_of(code)->closes; }
