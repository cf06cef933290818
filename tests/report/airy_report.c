// SPDX-License-Identifier: Apache-2.0
/*
 * airy_report.c - the measurements of `make report`: CSV files in a folder, of which report_page makes the page. Everything
 * runs on two cores, as in airy_bench. The methods are measured once; the engine on every Vulkan device there is.
 */
#include <errno.h>
#include <getopt.h>
#include <stdlib.h>
#include <string.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "airy.h"
#include "report.h"

static const char usage[] =
    "Usage: airy_report [--quick|--tiny] [--large] [--frames DIR] DIR\n"
    "Measures speed against error, shimmer and cost, and writes speed.csv, shimmer.csv, size.csv, tiles.csv,\n"
    "frames.csv, machine.csv and notes.csv into DIR.\n\n"
    "      --quick        no 4K, fewer turns and phases: about a minute\n"
    "      --tiny         small frames, one turn: to test the report itself\n"
    "      --large        the 16K frame too\n"
    "      --frames DIR   real EXR frames, to see what work is skipped on them\n";

static FILE *sheet(const struct report *r, const char *name, const char *header)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s.csv", r->dir, name);
    FILE *f = fopen(path, "we");
    if (!f)
        die("%s: %s", path, strerror(errno));
    fprintf(f, "%s\n", header);
    return f;
}

static void sheets_open(struct report *r)
{
    r->speed = sheet(r, "speed", "device,size,psf,method,setting,type,error,ms,ms_min,ms_max,ratio_to_copy,turns,rule,plan");
    r->shimmer = sheet(r, "shimmer", "method,setting,x_px,peak,energy");
    r->size = sheet(r, "size", "device,side,ms,device_ms,ns_per_pixel");
    r->tiles = sheet(r, "tiles", "device,pattern,percent,tiles,tiles_bright,ms,skipped");
    r->frames = sheet(r, "frames", "file,target,width,height,tiles,tiles_bright,skipped_percent,max_bright,chunks,chunks_copied,"
                                   "untouched,skipped");
    r->machine = sheet(r, "machine", "what,value");
    r->notes = sheet(r, "notes", "section,note");
}

static void sheets_close(struct report *r)
{
    FILE *all[] = { r->speed, r->shimmer, r->size, r->tiles, r->frames, r->machine, r->notes };
    for (unsigned i = 0; i < sizeof all / sizeof all[0]; i++)
        if (ferror(all[i]) | fclose(all[i]))
            die("%s: a file cannot be written", r->dir);
}

static void machine_system(struct report *r, unsigned used)
{
    char text[320];
    struct utsname u;
    uname(&u);
    bench_cpu(text, sizeof text);
    sheet_row(r->machine, "ss", "CPU", text);
    snprintf(text, sizeof text, "%u of %ld", used, sysconf(_SC_NPROCESSORS_ONLN));
    sheet_row(r->machine, "ss", "cores used", text);
    snprintf(text, sizeof text, "%s %s, %s", u.sysname, u.release, u.machine);
    sheet_row(r->machine, "ss", "system", text);
    sheet_row(r->machine, "ss", "airyd", AIRY_VERSION);
    sheet_row(r->machine, "ss", "compiler", __VERSION__);
}

static unsigned devices;
static void count_device(const char *line)
{
    (void)line;
    devices++;
}

static void device_open(struct report *r, unsigned i)
{
    char index[16], text[600];
    struct fault f;
    snprintf(index, sizeof index, "%u", i);
    const struct bloom_options options = { .device = i ? index : NULL, .slots = 2 };
    if (bloom_create(&r->engine, &options, &f) < 0)
        die("device %u: %s", i, f.text);
    const struct bloom_device_info *d = bloom_device(r->engine);
    snprintf(r->device, sizeof r->device, "%.127s", d->name);
    snprintf(text, sizeof text, "%s; %s", d->name, d->driver);
    sheet_row(r->machine, "ss", "device", text);
}

// The best device has the whole report; every other one its line in speed.csv.
static void other_devices(struct report *r)
{
    char first[sizeof r->device];
    memcpy(first, r->device, sizeof first);
    for (unsigned i = 0; i < devices && devices > 1; i++) {
        char index[16];
        struct fault f;
        struct bloom *b;
        snprintf(index, sizeof index, "%u", i);
        const struct bloom_options options = { .device = index, .slots = 2 };
        if (bloom_create(&b, &options, &f) < 0) {
            report_note(r, "speed", "device %u: %s", i, f.text);
            continue;
        }
        if (strcmp(bloom_device(b)->name, first)) {
            r->engine = b;
            r->engine_only = true;
            snprintf(r->device, sizeof r->device, "%.127s", bloom_device(b)->name);
            sheet_row(r->machine, "ss", "device", r->device);
            report_speed(r);
        }
        bloom_destroy(b);
    }
}

static void read_options(struct report *r, int argc, char **argv)
{
    static const struct option known[] = {
        { "quick", no_argument, NULL, 'q' },        { "tiny", no_argument, NULL, 't' },
        { "large", no_argument, NULL, 'l' },        { "frames", required_argument, NULL, 'f' },
        { "help", no_argument, NULL, 'h' },         { NULL, 0, NULL, 0 },
    };
    for (int id; (id = getopt_long(argc, argv, "", known, NULL)) != -1;) {
        switch (id) {
        case 'q': r->extent = EXTENT_QUICK; break;
        case 't': r->extent = EXTENT_TINY; break;
        case 'l': r->large = true; break;
        case 'f': r->frames_dir = optarg; break;
        case 'h': fputs(usage, stdout); exit(EXIT_SUCCESS);
        default: fputs(usage, stderr); exit(2);
        }
    }
    if (optind + 1 != argc) {
        fputs(usage, stderr);
        exit(2);
    }
    r->dir = argv[optind];
}

int main(int argc, char **argv)
{
    static struct report r = { .extent = EXTENT_FULL };
    double t0 = now_ms();
    read_options(&r, argc, argv);
    setvbuf(stdout, NULL, _IOLBF, 0);
    sheets_open(&r);
    machine_system(&r, bench_pin());
    r.team = team_create();
    bloom_list_devices(count_device);
    device_open(&r, 0);
    report_speed(&r);
    report_shimmer(&r);
    report_tiles(&r);
    report_frames(&r);
    report_size(&r);
    bloom_destroy(r.engine);
    other_devices(&r);
    team_destroy(r.team);
    char seconds[32];
    snprintf(seconds, sizeof seconds, "%.0f s", (now_ms() - t0) * 1e-3);
    sheet_row(r.machine, "ss", "measured in", seconds);
    sheets_close(&r);
    return EXIT_SUCCESS;
}
