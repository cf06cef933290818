// SPDX-License-Identifier: Apache-2.0
// cmd_plan.c - airy plan: what airy bloom would run for a file, and what it would promise, without running it.
#include <stdio.h>
#include <unistd.h>

#include "cmd.h"
#include "cmd_asset.h"
#include "cmd_bloom.h"
#include "cmd_report.h"

static void complain(const struct airy_error *e)
{
    if (e->code > 0)
        cmd_complain("plan: %s%s%s [%s %d]", report_field(e), *e->field ? ": " : "", e->text, e->symbol, e->code);
    else
        cmd_complain("plan: %s%s%s", e->field, *e->field ? ": " : "", e->text);
}

static int ask(struct airy *a, const struct run_options *run, int input_fd, struct airy_result **result,
               struct airy_error *e)
{
    struct airy_request request;
    uint64_t id;
    if (assets_send(a, &run->request, &request, e) < 0)
        return -1;
    request.input_fd = input_fd;
    request.plan_only = true;
    if (airy_submit(a, &request, &id, e) < 0)
        return -1;
    return airy_wait(a, id, -1, result, e) == 1 ? 0 : -1;
}

enum cmd_exit cmd_plan(int argc, char **argv)
{
    static struct bloom_asked a = BLOOM_ASKED_INIT;
    struct session session = SESSION_NONE;
    struct airy_result *result = NULL;
    struct airy_error e;
    char why[RUN_WHY_MAX];
    if (bloom_asked_read(&a, BLOOM_FOR_PLAN, argc, argv) < 0)
        return CMD_USAGE;
    if (a.help)
        return cmd_help(2, (char *[]){ (char *)"help", (char *)"plan", NULL });
    int fd = run_input_open(a.input, why, sizeof(why));
    if (fd < 0) {
        cmd_complain("plan: %s", why);
        return CMD_INPUT;
    }
    enum cmd_exit exit = CMD_DONE;
    if (session_open(&session, &a.run.session, &e) < 0 || ask(session.airy, &a.run, fd, &result, &e) < 0) {
        complain(&e);
        exit = cmd_exit_of(&e);
    } else if (a.run.json) {
        report_json_plan(a.input, result);
    } else {
        report_plan(a.input, result);
    }
    airy_result_free(result);
    session_close(&session);
    close(fd);
    return exit;
}
