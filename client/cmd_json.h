/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_json.h - writes one JSON value to a stream, on one line. The caller keeps objects and arrays
 * balanced. key is NULL inside arrays. What JSON cannot say becomes null (NaN, Inf) or U+FFFD (bytes
 * that are not UTF-8).
 */
#ifndef AIRY_CMD_JSON_H
#define AIRY_CMD_JSON_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

struct json {
    FILE *out;
    bool comma; /* a value stands before in this object or array */
};

void json_open(struct json *j, const char *key, char bracket);        /* '{' or '[' */
void json_close(struct json *j, char bracket);                        /* '}' or ']' */
void json_string(struct json *j, const char *key, const char *value); /* NULL: null */
void json_number(struct json *j, const char *key, double value);
void json_integer(struct json *j, const char *key, int64_t value);
void json_count(struct json *j, const char *key, uint64_t value);
void json_bool(struct json *j, const char *key, bool value);
void json_null(struct json *j, const char *key);
void json_line(struct json *j); /* ends the line and flushes it */

#endif
