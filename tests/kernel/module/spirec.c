// SPDX-License-Identifier: GPL-2.0
// A SPI controller without hardware, with two spidev children: it records what it is asked to do, in order.
//
// The log is /sys/kernel/debug/spirec/log, an array of struct rec (tests/kernel/inside/wire.py reads it); writing to it
// empties it. The parameters make it fail, lose, hang or take longer; transfers are counted from 1.
#include <linux/debugfs.h>
#include <linux/delay.h>
#include <linux/ktime.h>
#include <linux/module.h>
#include <linux/platform_device.h>
#include <linux/sched.h>
#include <linux/spi/spi.h>
#include <linux/uaccess.h>
#include <linux/vmalloc.h>

enum { ASSERTED = 1, RELEASED, BEGIN, END, PREPARE, UNPREPARE, LOST };

struct rec {
	u64 ns;
	u32 pid, speed, mode;
	u16 len;
	u8 type, bits;
	s16 ret;
	u16 delay_us;
	u8 data[20];
};
#define NREC (1 << 19)

static struct rec *log;
static atomic_t head = ATOMIC_INIT(0);

static int fail_in;		/* this transfer from now on fails at once: EIO */
module_param(fail_in, int, 0644);
static int lose_in;		/* this transfer never ends, so that spi.c gives up on it: ETIMEDOUT */
module_param(lose_in, int, 0644);
static int lose_zeros;		/* so do all transfers of one zero byte */
module_param(lose_zeros, int, 0644);
static int hang_in;		/* this transfer stands still for hang_ms in the driver, and then passes */
module_param(hang_in, int, 0644);
static int hang_ms = 2000;
module_param(hang_ms, int, 0644);
static int xfer_sleep_us;	/* each transfer takes so much longer */
module_param(xfer_sleep_us, int, 0644);

static struct platform_device *pdev;
static struct spi_controller *ctl;
static struct dentry *dir;

static struct rec *put(int type, struct spi_device *spi)
{
	unsigned int at = atomic_inc_return(&head) - 1;
	struct rec *r;

	if (at >= NREC)
		return NULL;
	r = &log[at];
	memset(r, 0, sizeof(*r));
	r->type = type;
	r->pid = current->tgid;
	r->mode = spi->mode;
	r->ns = ktime_get_ns();
	return r;
}

static void rec_set_cs(struct spi_device *spi, bool level)
{
	put(level ? RELEASED : ASSERTED, spi);
}

static int rec_prepare(struct spi_controller *c, struct spi_message *m)
{
	put(PREPARE, m->spi);
	return 0;
}

static int rec_unprepare(struct spi_controller *c, struct spi_message *m)
{
	struct rec *r = put(UNPREPARE, m->spi);

	if (r)
		r->ret = m->status;
	return 0;
}

static bool is_this(int *in)
{
	return *in > 0 && --*in == 0;
}

static int rec_one(struct spi_controller *c, struct spi_device *spi, struct spi_transfer *t)
{
	struct rec *r = put(BEGIN, spi);
	u64 ns = t->speed_hz ? (u64)t->len * 8 * 1000000000ULL / t->speed_hz : 0;
	u64 end = ktime_get_ns() + ns;
	int ret = 0;

	if (r) {
		r->speed = t->speed_hz;
		r->len = t->len;
		r->bits = t->bits_per_word;
		r->delay_us = t->delay.value;
		if (t->tx_buf)
			memcpy(r->data, t->tx_buf, min_t(u32, t->len, sizeof(r->data)));
	}
	if (is_this(&lose_in) || (lose_zeros && t->len == 1 && t->tx_buf && !*(u8 *)t->tx_buf)) {
		put(LOST, spi);
		return 1;	/* "it is under way" */
	}
	if (is_this(&hang_in))
		msleep(hang_ms);
	if (is_this(&fail_in))
		ret = -EIO;
	if (!ret) {
		if (xfer_sleep_us)
			usleep_range(xfer_sleep_us, xfer_sleep_us + 10);
		while (ktime_get_ns() < end)
			cpu_relax();
		if (t->rx_buf)
			memset(t->rx_buf, 0, t->len);
	}
	r = put(END, spi);
	if (r)
		r->ret = ret;
	return ret;
}

static ssize_t log_read(struct file *f, char __user *b, size_t n, loff_t *p)
{
	unsigned int h = min_t(unsigned int, atomic_read(&head), NREC);

	return simple_read_from_buffer(b, n, p, log, (size_t)h * sizeof(struct rec));
}

static ssize_t log_write(struct file *f, const char __user *b, size_t n, loff_t *p)
{
	atomic_set(&head, 0);
	return n;
}

static const struct file_operations fops = {
	.owner = THIS_MODULE, .read = log_read, .write = log_write, .llseek = default_llseek,
};

static int rec_probe(struct platform_device *p)
{
	int ret, i;

	ctl = spi_alloc_master(&p->dev, 0);
	if (!ctl)
		return -ENOMEM;
	ctl->bus_num = 0;
	ctl->num_chipselect = 2;
	ctl->mode_bits = SPI_CPHA | SPI_CPOL;
	ctl->bits_per_word_mask = SPI_BPW_MASK(8) | SPI_BPW_MASK(16);
	ctl->max_speed_hz = 20000000;
	ctl->set_cs = rec_set_cs;
	ctl->transfer_one = rec_one;
	ctl->prepare_message = rec_prepare;
	ctl->unprepare_message = rec_unprepare;
	ret = spi_register_controller(ctl);
	if (ret) {
		spi_controller_put(ctl);
		return ret;
	}
	for (i = 0; i < 2; i++) {
		/* A name that Linux's spidev knows; "spidev" itself is not one. */
		struct spi_board_info info = { .max_speed_hz = 20000000, .chip_select = i, .mode = SPI_MODE_0 };

		strscpy(info.modalias, "dh2228fv", sizeof(info.modalias));
		spi_new_device(ctl, &info);
	}
	return 0;
}

static int rec_remove(struct platform_device *p)
{
	spi_unregister_controller(ctl);
	return 0;
}

static struct platform_driver drv = { .driver = { .name = "spirec" }, .probe = rec_probe, .remove = rec_remove };

static int __init rec_init(void)
{
	int ret;

	log = vzalloc((size_t)NREC * sizeof(struct rec));
	if (!log)
		return -ENOMEM;
	dir = debugfs_create_dir("spirec", NULL);
	debugfs_create_file("log", 0600, dir, NULL, &fops);
	ret = platform_driver_register(&drv);
	if (ret)
		goto out;
	pdev = platform_device_register_simple("spirec", -1, NULL, 0);
	if (!IS_ERR(pdev))
		return 0;
	ret = PTR_ERR(pdev);
	platform_driver_unregister(&drv);
out:
	debugfs_remove(dir);
	vfree(log);
	return ret;
}

static void __exit rec_exit(void)
{
	platform_device_unregister(pdev);
	platform_driver_unregister(&drv);
	debugfs_remove(dir);
	vfree(log);
}

module_init(rec_init);
module_exit(rec_exit);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("An SPI controller without hardware that records");
